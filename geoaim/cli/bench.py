"""The command that measures a stage on one's own data."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from geoaim.cli import options
from geoaim.cli.console import console, report_errors, show_progress
from geoaim.cli.outputs import check_output


def bench(
    stage: Annotated[Literal["registration"], typer.Argument(help="what is measured")],
    video: Annotated[str, typer.Argument(help="your own video: consistency and speed")],
    output: Annotated[Path, options.output("folder for tables and charts")] = Path("bench"),
    quick: Annotated[bool, typer.Option("--quick", help="fewer frames: a minute")] = False,
) -> None:
    """Measure on your own video how well its frames are registered, and how fast.

    Your own video has no truth: each setting is compared with itself, with a homography, and with
    the uncertainty that it states. Writes video.json, video.md and charts.

    Comparisons with other methods, on synthetic videos with exact truth and on public data, are in
    the repository: python -m benchmarks.

    Example: geoaim bench registration samples/hover.mp4 --quick -o bench
    """
    from geoaim.mapping.bench.own_video import measure_own_video
    from geoaim.mapping.bench.report import write_results

    with show_progress() as progress, report_errors():
        check_output(output / "video.json")
        results = measure_own_video(video, quick, progress)
        words = ["geoaim bench", stage, video, "--quick" if quick else ""]
        paths = write_results(results, output, "video", " ".join(filter(None, words)))
    console.print(", ".join(str(path) for path in paths))
