"""The command that measures the registration of one's own video."""

import json
import math
import os
import platform
from pathlib import Path
from typing import Annotated

import typer

from geoaim.base.files import atomic_write
from geoaim.cli import options
from geoaim.cli.console import console, report_errors, show_progress
from geoaim.cli.outputs import check_output


def bench(
    video: Annotated[str, typer.Argument(help="your own video")],
    output: Annotated[Path, options.output("folder for picture and tables")] = Path("bench"),
    quick: Annotated[bool, typer.Option("--quick", help="fewer frames: half a minute")] = False,
) -> None:
    """Measure how well and how fast your own video is registered, beside ORB, KLT and ECC.

    Your own video has no truth: frames are registered to three references, and ways from one to
    another must end in the same place. Writes video.png, video.md and video.json.

    Comparisons on videos with exact truth, and of the other stages, are in the repository:
    python -m benchmarks.

    Example: geoaim bench samples/hover.mp4 -o bench
    """
    from geoaim.mapping.registration.own_video import (
        describe_own_video,
        draw_own_video,
        measure_own_video,
    )

    picture, page, table = (output / f"video.{suffix}" for suffix in ("png", "md", "json"))
    with show_progress() as progress, report_errors():
        check_output(table)
        rows = measure_own_video(video, quick, progress)
        sentences = list(describe_own_video(rows))
        with atomic_write(picture) as part:
            draw_own_video(rows).savefig(part, format="png", dpi=110)
        command = f"geoaim bench {video}{' --quick' * quick}"
        with atomic_write(page) as part:
            lines = [f"`{command}`", *sentences, "![error against time](video.png)"]
            part.write_text("\n\n".join([*lines, _format_table(rows)]) + "\n", encoding="utf-8")
        machine = {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()}
        for row in rows:  # JSON has no NaN
            row |= {k: None for k, v in row.items() if isinstance(v, float) and math.isnan(v)}
        with atomic_write(table) as part:
            content = {"command": command, "machine": machine, "rows": rows}
            part.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    for sentence in sentences:
        console.print(sentence)
    console.print(f"{picture}, {page}, {table}")


def _format_table(rows: list[dict[str, object]]) -> str:
    names = list(rows[-1])
    cells = [[row.get(name, "") for name in names] for row in rows]
    texts = [[f"{v:.3g}" if isinstance(v, float) else str(v) for v in row] for row in cells]
    return "\n".join(f"| {' | '.join(line)} |" for line in [names, ["---"] * len(names), *texts])
