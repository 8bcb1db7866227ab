"""The command that measures a stage on one's own data."""

import json
import math
import os
import platform
from pathlib import Path
from typing import Annotated, Literal

import typer

from geoaim.base.files import atomic_write
from geoaim.cli import options
from geoaim.cli.console import console, report_errors, show_progress
from geoaim.cli.outputs import check_output


def bench(
    stage: Annotated[Literal["registration"], typer.Argument(help="what is measured")],
    video: Annotated[str, typer.Argument(help="your own video: consistency and speed")],
    output: Annotated[Path, options.output("folder for the tables")] = Path("bench"),
    quick: Annotated[bool, typer.Option("--quick", help="fewer frames: a minute")] = False,
) -> None:
    """Measure on your own video how well its frames are registered, and how fast.

    Your own video has no truth: each setting is compared with itself, with a homography, and with
    the uncertainty that it states. Writes video.json and video.md.

    Comparisons with other methods, on synthetic videos with exact truth and on public data, are in
    the repository: python -m benchmarks.

    Example: geoaim bench registration samples/hover.mp4 --quick -o bench
    """
    from geoaim.mapping.registration.own_video import measure_own_video

    table, page = output / "video.json", output / "video.md"
    with show_progress() as progress, report_errors():
        check_output(table)
        rows = measure_own_video(video, quick, progress)
        command = f"geoaim bench {stage} {video}{' --quick' * quick}"
        machine = {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()}
        for row in rows:  # JSON has no NaN
            row |= {k: None for k, v in row.items() if isinstance(v, float) and math.isnan(v)}
        with atomic_write(table) as part:
            content = {"command": command, "machine": machine, "rows": rows}
            part.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        with atomic_write(page) as part:
            cells = [list(rows[0]), ["---"] * len(rows[0])]
            cells += [
                [f"{v:.3g}" if isinstance(v, float) else str(v) for v in row.values()]
                for row in rows
            ]
            lines = "\n".join(f"| {' | '.join(line)} |" for line in cells)
            part.write_text(f"`{command}`\n\n{lines}\n", encoding="utf-8")
    console.print(f"{table}, {page}")
