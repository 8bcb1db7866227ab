"""The command that generates synthetic places."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from geoaim.cli import options
from geoaim.cli.console import console, report_errors, show_progress

PlaceKind = Literal["junction", "t", "roundabout", "street", "park", "campus"]
VideoSize = Literal["none", "720p", "1080p", "4k"]


def sample(
    folder: Annotated[Path, typer.Argument(help="folder to write, new or empty")],
    seed: options.Seed = 1,
    kind: Annotated[PlaceKind, typer.Option(help="kind of place")] = "junction",
    minutes: Annotated[float, typer.Option(help="minutes of traffic", min=0.2, max=1440)] = 1.0,
    video: Annotated[VideoSize, typer.Option(help="size of the drone video")] = "720p",
) -> None:
    """Generate a synthetic place with ground truth: video, tracks, lights, HD map and imagery.

    The same seed gives the same data and rendered frames on every machine; the encoded video may
    differ. The video lasts 12 s, whatever the minutes of traffic. README.md in the folder describes
    each file. The folder appears when it is complete; no existing file is replaced or deleted,
    earlier samples included.

    Example: geoaim sample place --seed 2 --kind roundabout
    """
    from geoaim.base.files import check_new_folder
    from geoaim.synthetic import VIDEOS, make_sample, write_sample

    with show_progress() as progress, report_errors():
        check_new_folder(folder)
        progress("place", 0, 1)
        generated = make_sample(seed, kind=kind, minutes=minutes, video=VIDEOS.get(video))
        write_sample(generated, folder, progress=progress)
    console.print(f"{folder}: see {folder / 'README.md'}")
