"""What all benchmarks share: the machine in words, tables and JSON."""

import json
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from geoaim.files import atomic_write

Row = Mapping[str, Any]


def machine() -> dict[str, Any]:
    """What the figures were measured on, and with which versions."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        name = names[0].split(":", 1)[1].strip() if names else name
    return {
        "processor": name,
        "cores": cv2.getNumberOfCPUs(),
        "opencv": cv2.__version__,
        "opencv_threads": cv2.getNumThreads(),
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def peak_megabytes() -> float:
    """The most memory that this process has held.

    Not by getrusage where /proc tells it: a child inherits that figure from its parent.
    """
    status = Path("/proc/self/status")
    if status.exists():
        line = next(x for x in status.read_text().splitlines() if x.startswith("VmHWM"))
        return float(line.split()[1]) / 1024
    import resource  # not on Windows

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024 if platform.system() == "Linux" else 1024**2)


def medians(parts: Sequence[Callable[[], Any]], repeats: int) -> list[float]:
    """Seconds of each part: timed in turn after one round to warm up, the median of each."""
    seconds: list[list[float]] = [[] for _ in parts]
    for _ in range(repeats + 1):
        for part, found in zip(parts, seconds, strict=True):
            start = time.perf_counter()
            part()
            found.append(time.perf_counter() - start)
    return [float(np.median(found[1:])) for found in seconds]


def table(rows: Sequence[Row]) -> str:
    """A Markdown table; the columns are the keys of the first row."""
    names = list(rows[0])
    lines = ["| " + " | ".join(names) + " |", "|" + " --- |" * len(names)]
    lines += ["| " + " | ".join(_cell(row.get(name, "")) for name in names) + " |" for row in rows]
    return "\n".join(lines)


def save(rows: Sequence[Row], path: Path | None, *, command: str, **settings: Any) -> None:
    """Write the rows, the machine and the command that made them as JSON."""
    if path is None:
        return
    content = {"command": command, "machine": machine(), **settings, "rows": list(rows)}
    write_json(content, path)


def write_json(content: Any, path: Path) -> None:
    """Write plain numbers, and arrays as lists."""
    with atomic_write(path) as temporary:
        text = json.dumps(content, indent=1, default=_plain) + "\n"
        temporary.write_text(text, encoding="utf-8")


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value.tolist()
