"""Make a place with truth: python -m benchmarks.synthetic FOLDER --help."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from benchmarks.synthetic.files import write_sample
from benchmarks.synthetic.roads.layouts import PlaceKind
from benchmarks.synthetic.sample import VIDEOS, make_sample
from geoaim.base.files import check_new_folder
from geoaim.cli.console import console, report_errors, show_progress

VideoSize = Literal["none", "720p", "1080p", "4k"]


def main(
    folder: Annotated[Path, typer.Argument(help="folder to write, new or empty")],
    seed: Annotated[int, typer.Option(help="random seed", min=0)] = 1,
    kind: Annotated[PlaceKind, typer.Option(help="kind of place")] = "junction",
    minutes: Annotated[float, typer.Option(help="minutes of traffic", min=0.2, max=1440)] = 1.0,
    video: Annotated[VideoSize, typer.Option(help="size of the drone video")] = "720p",
) -> None:
    """Make a place with truth: video, tracks, lights, HD map and imagery.

    The same seed gives the same data and rendered frames on every machine; the encoded video may
    differ. The video lasts 12 s, whatever the minutes of traffic. README.md in the folder describes
    each file. The folder appears when it is complete; no existing file is replaced or deleted.

    Example: python -m benchmarks.synthetic place --seed 2 --kind roundabout
    """
    with show_progress() as progress, report_errors():
        check_new_folder(folder)
        progress("place", 0, 1)
        sample = make_sample(seed, kind=kind, minutes=minutes, video=VIDEOS.get(video))
        write_sample(sample, folder, progress=progress)
    console.print(f"{folder}: see {folder / 'README.md'}")


if __name__ == "__main__":
    typer.run(main)
