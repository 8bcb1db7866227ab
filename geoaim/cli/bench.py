"""The command that compares the mapping's stages with other methods."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from geoaim.cli import options
from geoaim.cli.console import console, report_errors, show_progress
from geoaim.cli.outputs import check_output

Stage = Literal["registration", "background", "georeference", "stability"]


def bench(
    stage: Annotated[Stage, typer.Argument(help="what is measured")],
    video: Annotated[
        str | None,
        typer.Argument(help="your own video, for registration only: consistency and speed"),
    ] = None,
    output: Annotated[Path, options.output("folder for tables and charts")] = Path("bench"),
    quick: Annotated[
        bool, typer.Option("--quick", help="a minute a stage: few and small cases")
    ] = False,
) -> None:
    """Compare a mapping stage with other methods and its own settings, in error and time.

    Each setting is measured at several values.

    Writes STAGE.json, STAGE.md and charts. The videos are synthetic, with exact truth; where the
    environment variable GEOAIM_DATA names the folder of real images, videos made from these are
    measured instead or as well. Your own video has no truth: then each setting is compared with
    itself, with a homography, and with the uncertainty that it states.

    Example: geoaim bench registration samples/hover.mp4 --quick -o bench
    """
    from benchmarks.stages import BENCHMARKS
    from geoaim.mapping.bench.own_video import measure_own_video
    from geoaim.mapping.bench.report import write_results

    with show_progress() as progress, report_errors():
        name = "video" if video else str(stage)
        check_output(output / f"{name}.json")
        if video is None:
            results = BENCHMARKS[stage](quick, progress)
        elif stage == "registration":
            results = measure_own_video(video, quick, progress)
        else:
            raise ValueError(f"{stage} is not measured on your own video; registration is")
        words = ["geoaim bench", stage, video or "", "--quick" if quick else ""]
        paths = write_results(results, output, name, " ".join(filter(None, words)))
    console.print(", ".join(str(path) for path in paths))
