"""The command that makes places."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from geoaim.cli.console import console, plain_errors, stages

PlaceKind = Literal["junction", "t", "roundabout", "street", "park", "campus"]
VideoSize = Literal["none", "720p", "1080p", "4k"]


def sample(
    folder: Annotated[Path, typer.Argument(help="where the sample goes")],
    seed: Annotated[int, typer.Option(help="of everything random", min=0)] = 1,
    kind: Annotated[PlaceKind, typer.Option(help="of place")] = "junction",
    minutes: Annotated[float, typer.Option(help="of traffic", min=0.2, max=1440)] = 1.0,
    video: Annotated[VideoSize, typer.Option(help="of the drone's video")] = "720p",
) -> None:
    """Make a place with truth for everything: video, tracks, lights, HD map, imagery.

    The same seed gives the same numbers and frames on every machine. The video has 12 s, whatever
    the minutes of traffic. README.md in the folder says what each file is. A sample that is there
    already is replaced; a folder that holds anything else is refused.
    """
    from geoaim.synthetic import VIDEOS, make_sample, write_sample
    from geoaim.synthetic.files import check_folder

    with stages() as progress, plain_errors():
        check_folder(folder)
        progress("place", 0, 1)
        made = make_sample(seed, kind=kind, minutes=minutes, video=VIDEOS.get(video))
        write_sample(made, folder, progress=progress)
    console.print(f"{folder}: see {folder / 'README.md'}")
