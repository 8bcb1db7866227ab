"""What all commands share: progress bars, plain errors, options."""

import os
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import rich.progress
import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from geoaim.errors import GeoaimError, GeoaimWarning
from geoaim.progress import Progress

if TYPE_CHECKING:
    from geoaim.tracks import Tracks

console = Console(stderr=True)

AimFile = Annotated[Path, typer.Argument(help="an AIM written by geoaim build, align or draw")]
TracksFile = Annotated[
    Path,
    typer.Option(help="tracks: geoaim's, INTERACTION, SinD, inD, highD, geo-trax, Stanford Drone"),
]
TracksWorld = Annotated[
    str | None,
    typer.Option(
        help="CRS, easting and northing of (0, 0) of tracks that do not say it: "
        "'EPSG:32632 459000 5428000'"
    ),
]
TracksPixel = Annotated[
    float | None, typer.Option(help="m per pixel of tracks in an image's pixels")
]


class Rate(ProgressColumn):
    """Frames a second."""

    def render(self, task: Task) -> Text:
        """Draw the rate once there is one."""
        return Text(f"{task.speed:.1f} frames/s" if task.speed else "", style="progress.data.speed")


@contextmanager
def stages() -> Iterator[Progress]:
    """A progress bar a stage; the yielded function takes stage, done and total."""
    columns = (
        TextColumn("{task.description:<12}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        Rate(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    tasks: dict[str, TaskID] = {}
    with rich.progress.Progress(*columns, console=console) as bars:

        def progress(stage: str, done: float, total: float | None) -> None:
            if stage not in tasks:
                for task in bars.task_ids:
                    bars.update(task, completed=bars.tasks[task].total or 1, total=1)
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield progress


@contextmanager
def plain_errors() -> Iterator[None]:
    """Warnings as yellow lines; an error of the data as one red line and exit code 1."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", GeoaimWarning)
        warnings.showwarning = _show_warning
        try:
            yield
        except (GeoaimError, OSError, ValueError) as error:
            console.print(Text.assemble((type(error).__name__, "bold red"), f": {error}"))
            sys.exit(1)


def read_any_tracks(path: Path, place: str | None, resolution: float | None) -> "Tracks":
    """Tracks of any known form, in the world that --tracks-world names."""
    from geoaim.track_formats import read_any
    from geoaim.world import World

    world = None
    if place is not None:
        try:
            crs, *numbers = place.split()
            east, north = map(float, numbers or ("0", "0"))
        except ValueError as error:
            raise ValueError(
                f"--tracks-world {place!r} is not a CRS and two numbers, such as "
                "'EPSG:32632 459000 5428000'"
            ) from error
        world = World(crs, (east, north))
    return read_any(path, world=world, resolution=resolution)


def refuse_output(
    output: Path, endings: tuple[str, ...] = (), inputs: Iterable[Path | None] = ()
) -> None:
    """Find out before the work whether its result can be written, over none of the inputs."""
    if endings and output.suffix.lower() not in endings:
        raise ValueError(f"{output}: give a name that ends in {' or '.join(endings)}")
    if output.resolve() in [path.resolve() for path in inputs if path is not None]:
        raise ValueError(f"{output} is read as well; give another name to write")
    if output.is_dir():
        raise ValueError(f"{output} is a folder; the name of a file is needed")
    folder = next(parent for parent in output.absolute().parents if parent.exists())
    if not folder.is_dir():
        raise ValueError(f"{folder} is a file; a folder is needed to write {output.name} into")
    if not os.access(folder, os.W_OK):
        raise ValueError(f"{folder} cannot be written to; choose another folder for {output.name}")


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    console.print(Text.assemble(("warning", "yellow"), f": {message}"))
