"""Time and memory of `geoaim build` beside a plain script, both run from the shell.

    python -m benchmarks.plain_script my_video.mp4 --json plain_script.json

The plain script is `benchmarks/plain_median.py`. Without a video, 7 s of a hover video at 1080p are
made. Its packets, repeated, are a second video of 60 s. The two take turns, a process each time,
imports and output included; the first round compiles the modules and does not count.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks import plain_median
from benchmarks.hover_videos import make_hover_video
from benchmarks.pipeline import repeat_packets
from benchmarks.results import JsonFile, print_rows, write_rows
from benchmarks.synthetic import write_video

SECONDS, RATE = 7, 30
LONG_SECONDS = 60.0
ROUNDS = 3
GEOAIM = "from geoaim.cli import app; app()"
METHODS = {
    "geoaim build": ("-c", GEOAIM, "build", "{video}", "--frame-resolution", "0.05", "-o", "a.tif"),
    "plain script": (os.path.abspath(plain_median.__file__), "{video}", "a.png"),
}


def _run(method: str, video: Path, folder: Path) -> tuple[float, float, float]:
    """Run a method in a process; seconds, processor seconds and MiB."""
    words = [word.format(video=video) for word in METHODS[method]]
    start = time.perf_counter()
    with open(folder / "messages.txt", "w") as file:
        process = subprocess.Popen(
            [sys.executable, *words], cwd=folder, env=_choose_environment(folder), stderr=file
        )
        _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError((folder / "messages.txt").read_text())
    return time.perf_counter() - start, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def _choose_environment(folder: Path) -> Mapping[str, str]:
    """Have modules compiled once, also where the environment says otherwise."""
    given = {name: text for name, text in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    root = Path(__file__).parents[1]
    return given | {"PYTHONPYCACHEPREFIX": str(folder / "compiled"), "PYTHONPATH": str(root)}


def measure(video: Path, folder: Path) -> Iterator[dict[str, Any]]:
    """Measure both methods in turns: medians, and the ratio to the plain script."""
    rounds = [[_run(method, video, folder) for method in METHODS] for _ in range(ROUNDS + 1)]
    medians = np.median(rounds[1:], axis=0)
    ratios = np.median([np.array(one) / one[-1] for one in rounds[1:]], axis=0)
    for method, row, ratio in zip(METHODS, medians, ratios, strict=True):
        names = dict(zip(("s", "processor s", "MiB"), row.tolist(), strict=True))
        yield {"method": method} | names | {"processor ratio": float(ratio[1])}


def main(
    video: Annotated[Path | None, typer.Argument(help="the video; none: one is made")] = None,
    json: JsonFile = None,
) -> None:
    """Measure both on a video; print the table; write JSON if asked."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        if (path := video) is None:
            made = make_hover_video("00003", size="1080p", count=SECONDS * RATE, kind="queue")
            path = write_video(made, folder / "clip.mp4", megabits=20.0)
        long = repeat_packets(path, folder / "long.mp4", LONG_SECONDS)
        cases = {"as it is": path.resolve(), "repeated to 60 s": long}
        rows = print_rows(
            {"video": case} | row for case, file in cases.items() for row in measure(file, folder)
        )
    write_rows(rows, json, command="python -m benchmarks.plain_script", rounds=ROUNDS)


if __name__ == "__main__":
    typer.run(main)
