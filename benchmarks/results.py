"""What all benchmarks share: options, timing, processes, the machine, tables and JSON."""

import json
import platform
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from datetime import date
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any, TypeVar

import cv2
import numpy as np
import typer
from matplotlib.figure import Figure

from geoaim.base.files import atomic_write
from geoaim.base.progress import Progress

ROOT = Path(__file__).parent.parent
Row = Mapping[str, Any]
Result = TypeVar("Result")
Clock = Callable[[], float]
JsonFile = Annotated[Path | None, typer.Option("--json", help="JSON file to write")]
ChartFile = Annotated[Path | None, typer.Option("--chart", help="chart to write")]


@dataclass(frozen=True, eq=False)
class Results:
    """What a benchmark measured."""

    title: str  # what was measured, in a sentence
    tables: Mapping[str, Sequence[Row]]  # rows by the name of their table
    charts: dict[str, Figure] = field(default_factory=dict)  # figures by name


def describe_machine() -> dict[str, Any]:
    """Describe the processor, its cores and the versions of the main libraries, by name."""
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


def describe_state() -> dict[str, Any]:
    """Describe what is measured: the commit, whether the package differs from it, and the date."""
    found: dict[str, Any] = {"commit": run_git("rev-parse", "--short=10", "HEAD").strip()}
    found["date"] = date.today().isoformat()
    changed = run_git("status", "--porcelain", "--", "geoaim").strip()
    return found | ({"uncommitted": True} if changed else {})


def run_git(*arguments: str) -> str:
    """Run git in the repository; nothing comes back where it fails or there is none."""
    command = ["git", "-C", str(ROOT), *arguments]
    try:
        return subprocess.run(command, check=False, capture_output=True, text=True).stdout
    except FileNotFoundError:
        return ""


def measure_peak_megabytes() -> float:
    """Return the peak resident memory of this process, MiB.

    /proc is preferred: with getrusage a child process inherits the peak of its parent.
    """
    status = Path("/proc/self/status")
    if status.exists():
        line = next(x for x in status.read_text().splitlines() if x.startswith("VmHWM"))
        return float(line.split()[1]) / 1024
    import resource  # not on Windows

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024 if platform.system() == "Linux" else 1024**2)


def run_in_process(function: Callable[..., Result], *arguments: object) -> Result:
    """Run a function of a module in a new process, whose peak memory is the function's own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


def time_medians(
    parts: Sequence[Callable[[], Any]], repeats: int, clock: Clock = time.perf_counter
) -> list[float]:
    """Time functions in turn, after one warm-up round.

    Args:
        parts: the functions.
        repeats: number of rounds.
        clock: gives seconds; `time.process_time` counts processor time only.

    Returns:
        The median duration of each, seconds.
    """
    durations: list[list[float]] = [[] for _ in parts]
    for _ in range(repeats + 1):
        for part, own in zip(parts, durations, strict=True):
            start = clock()
            part()
            own.append(clock() - start)
    return [float(np.median(own[1:])) for own in durations]


def format_table(rows: Sequence[Row]) -> str:
    """Format rows as a Markdown table whose columns are the keys of the first row."""
    names = list(rows[0])
    lines = ["| " + " | ".join(names) + " |", "|" + " --- |" * len(names)]
    lines += [
        "| " + " | ".join(_format_cell(row.get(name, "")) for name in names) + " |" for row in rows
    ]
    return "\n".join(lines)


def print_rows(measured: Iterable[Row]) -> list[Row]:
    """Print the rows of a table as they are measured, and return them."""
    rows: list[Row] = []
    for row in measured:
        rows.append(row)
        lines = format_table([row]).splitlines()
        print("\n".join(lines if len(rows) == 1 else lines[-1:]), flush=True)
    return rows


def collect(
    measured: Iterable[Row], stage: str, progress: Progress, total: int | None = None
) -> list[Row]:
    """Collect the rows of a table, and report progress after each.

    Args:
        measured: the rows.
        stage: the name that the progress shows, such as "settings".
        progress: called with the stage, the number of rows done, and their total.
        total: number of rows, if it is known.

    Returns:
        The rows.
    """
    rows: list[Row] = []
    progress(stage, 0, total)
    for row in measured:
        rows.append(row)
        progress(stage, len(rows), total)
    return rows


def write_rows(rows: Sequence[Row], path: Path | None, *, command: str, **settings: Any) -> None:
    """Write rows as JSON, with the machine and the command that made them.

    Args:
        rows: rows of a table.
        path: JSON file to write; None writes nothing.
        command: the command that makes the rows.
        settings: what else a reader must know.
    """
    if path is None:
        return
    content = {"command": command, "machine": describe_machine(), **settings, "rows": list(rows)}
    write_json(content, path)


def write_results(results: Results, folder: Path, name: str, command: str) -> list[Path]:
    """Write the results of a benchmark: NAME.json, NAME.md, and NAME-CHART.svg and .png.

    Args:
        results: what was measured.
        folder: the folder to write to.
        name: how the files' names begin.
        command: the command that measured it.

    Returns:
        The files.
    """
    machine = describe_machine()
    paths = [folder / f"{name}.json", folder / f"{name}.md"]
    tables = {title: [_clear(row) for row in rows] for title, rows in results.tables.items()}
    write_json({"command": command, "machine": machine, **tables}, paths[0])
    parts = [f"# {results.title}", f"`{command}`, {machine['cores']} x {machine['processor']}"]
    for chart, figure in results.charts.items():
        for suffix in ("svg", "png"):
            paths.append(folder / f"{name}-{chart}.{suffix}")
            with atomic_write(paths[-1]) as part:
                figure.savefig(part, dpi=110, format=suffix)
        parts.append(f"![{chart}]({name}-{chart}.png)")
    parts += [f"## {title}\n\n{format_table(rows)}" for title, rows in tables.items() if rows]
    with atomic_write(paths[1]) as part:
        part.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return paths


def write_json(content: Any, path: Path) -> None:
    """Write content as JSON, NumPy arrays as lists; what a command made states commit and date."""
    if isinstance(content, Mapping) and "command" in content:
        content = {"command": content["command"], **describe_state(), **content}
    with atomic_write(path) as temporary:
        text = json.dumps(content, indent=1, default=_to_plain) + "\n"
        temporary.write_text(text, encoding="utf-8")


def _clear(value: Any) -> Any:
    """Replace figures that do not exist by None, null in JSON."""
    if isinstance(value, Mapping):
        return {key: _clear(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_clear(part) for part in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _format_cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _to_plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value.tolist()
