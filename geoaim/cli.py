"""The command line: flags in, one call of the library, a table and files out."""

import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from geoaim.errors import GeoaimError, GeoaimWarning

if TYPE_CHECKING:
    from torch import Tensor

    from geoaim.aim import AIM
    from geoaim.mapping.hdmap import HDMap
    from geoaim.simulation.scene import Scene
    from geoaim.world import World

app = typer.Typer(
    name="geoaim",
    help="Aerial image-based maps (AIM) from drone video: register, average, georeference, export.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
console = Console(stderr=True)

Source = Annotated[str, typer.Argument(help="a video file, or a folder or glob of images")]
Points = Annotated[
    Path | None,
    typer.Option(help="control points: CSV, OpenDroneMap gcp_list.txt, QGIS .points"),
]
BoxFolder = Annotated[Path | None, typer.Option(help="folder of YOLO .txt files, one a frame")]
PolicyName = Literal["idm", "constant-velocity", "constant-turn-rate", "replay"]
PlaceKind = Literal["junction", "t", "roundabout", "street"]
VideoSize = Literal["none", "720p", "1080p", "4k"]
AimFile = Annotated[Path, typer.Argument(help="an AIM written by geoaim build")]


class Rate(ProgressColumn):
    """Frames a second."""

    def render(self, task: Task) -> Text:
        """Draw the rate once there is one."""
        return Text(f"{task.speed:.1f} frames/s" if task.speed else "", style="progress.data.speed")


@app.command()
def build(
    video: Source,
    output: Annotated[Path, typer.Option("--output", "-o", help="GeoTIFF to write")],
    gcps: Points = None,
    boxes: BoxFolder = None,
    frames: Annotated[str, typer.Option(help="auto, all, or how many")] = "auto",
    crs: Annotated[str | None, typer.Option(help="of the map, e.g. EPSG:32635")] = None,
    resolution: Annotated[
        float | None,
        typer.Option(help="metres a pixel, north up; as filmed if left out"),
    ] = None,
    pixel_size: Annotated[
        float | None, typer.Option(help="metres a pixel, for a local map without control points")
    ] = None,
) -> None:
    """Build a georeferenced AIM from a hovering drone's video, and a quick look beside it.

    Control points are picked on the first frame unless their file says on which. Without them the
    telemetry beside the video gives an approximate place, or --pixel-size a local one.
    """
    from geoaim.aim import rectify, write_aim
    from geoaim.mapping.approximate import local_georeference
    from geoaim.mapping.pipeline import build_aim
    from geoaim.mapping.video import open_video
    from geoaim.quicklook import write_quicklook

    with _stages() as progress, _plain_errors():
        if output.suffix.lower() not in (".tif", ".tiff"):
            raise ValueError(f"{output}: the map is a GeoTIFF; give a name that ends in .tif")
        if pixel_size is not None and gcps is not None:
            raise ValueError("--gcps and --pixel-size both say where the map lies; give one")
        _refuse_output(output)
        opened = open_video(video)
        size = opened.height, opened.width
        place = gcps if pixel_size is None else local_georeference(pixel_size=pixel_size, size=size)
        aim = build_aim(
            opened,
            place,
            boxes=boxes,
            frames=_count(frames),
            crs=crs,
            progress=progress,
        )
        progress("write", 0, 2)
        if resolution is not None or not aim.is_affine:
            aim = rectify(aim, resolution)
        write_aim(aim, output)
        progress("write", 1, 2)
        write_quicklook(aim, output.with_suffix(".png"))
        progress("write", 2, 2)
    _show(aim, f"{output} and {output.with_suffix('.png')}")


@app.command()
def register(
    video: Source,
    output: Annotated[Path, typer.Option("--output", "-o", help=".csv or .parquet to write")],
    boxes: BoxFolder = None,
    reference: Annotated[
        float | None, typer.Option(help="seconds of the reference; chosen by the data if left out")
    ] = None,
) -> None:
    """Lay every frame of a video on one reference frame: a table of matrices, a row a frame.

    m00 to m22 map a frame's pixels to the reference's. With --reference 0 these are the pixels of
    a map built with control points on the first frame.
    """
    from geoaim.mapping.registration import register as register_frames
    from geoaim.mapping.registration import tally, write_registration

    with _stages() as progress, _plain_errors():
        if output.suffix not in (".csv", ".parquet"):
            raise ValueError(f"{output}: the name must end in .csv or .parquet")
        _refuse_output(output)
        result = register_frames(video, boxes=boxes, reference_time=reference, progress=progress)
        write_registration(result, output)
    table = Table(title=Text(str(output)), show_header=False)
    table.add_row("motion model", result.reference.model)
    table.add_row("reference", f"frame {result.reference.index}, {result.reference.time:.2f} s")
    table.add_row("frames laid", f"{result.valid.sum()} of {len(result.valid)}")
    for reason, count in tally(result.reason).items():
        table.add_row("refused", f"{count}: {reason}")
    console.print(table)


@app.command()
def texture(
    aim: AimFile,
    folder: Annotated[Path, typer.Argument(help="where texture.png and texture.json go")],
    resolution: Annotated[float | None, typer.Option(help="metres a pixel")] = None,
) -> None:
    """Export an AIM as a texture and its corner frame, for a renderer."""
    from geoaim.aim import read_aim
    from geoaim.mapping.texture import export_texture

    with _plain_errors():
        export_texture(read_aim(aim), folder, resolution=resolution)
    console.print(f"{folder / 'texture.png'}, {folder / 'texture.json'}")


@app.command()
def info(aim: AimFile) -> None:
    """Say what an AIM is, where it lies and how far to trust it."""
    from geoaim.aim import read_aim

    with _plain_errors():
        found = read_aim(aim)
    _show(found, str(aim))


@app.command()
def render(
    aim: AimFile,
    tracks: Annotated[Path, typer.Option(help="tracks in the plain format, .csv or .parquet")],
    ego: Annotated[str, typer.Option(help="id of the agent in the middle, heading up")],
    output: Annotated[Path, typer.Option("--output", "-o", help=".mp4, .gif or .png to write")],
    size: Annotated[int, typer.Option(help="pixels of each side", min=16, max=4096)] = 512,
    metres: Annotated[float, typer.Option(help="metres of each side", min=1)] = 80.0,
    time: Annotated[float | None, typer.Option(help="s, of a .png; the first if left out")] = None,
    lights: Annotated[Path | None, typer.Option(help="changes of traffic lights, .csv")] = None,
    hdmap: Annotated[Path | None, typer.Option(help="lanelet2 map with their stop lines")] = None,
    trail: Annotated[float, typer.Option(help="s of everybody's way to draw", min=0)] = 0.0,
) -> None:
    """Draw what an agent has around it: the map, heading up, with all agents on it.

    Traffic lights are bars on their stop lines; --lights has states, --hdmap stop lines.
    """
    from geoaim.simulation.scene import agent_number, step_at

    with _stages() as progress, _plain_errors():
        _refuse_output(output)
        scene, _, _ = _scene(aim, tracks, lights, hdmap)
        agent = agent_number(scene, ego)
        step = step_at(scene, agent, time) if output.suffix.lower() == ".png" else None
        count = _film(
            scene, agent, output, progress, step=step, size=size, metres=metres, trail=trail
        )
    console.print(f"{output}: {count} pictures of {size} x {size} px around agent {ego}")


@app.command()
def simulate(
    aim: AimFile,
    tracks: Annotated[Path, typer.Option(help="tracks in the plain format, .csv or .parquet")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="tracks to write, .csv or .parquet")
    ],
    policy: Annotated[PolicyName, typer.Option(help="who drives")] = "idm",
    ego: Annotated[str | None, typer.Option(help="id of who drives; all if left out")] = None,
    start: Annotated[float, typer.Option(help="s of the tracks at which it begins")] = 0.0,
    seconds: Annotated[float, typer.Option(help="to simulate", min=0.1)] = 6.0,
    film: Annotated[Path | None, typer.Option(help=".mp4 or .gif around the ego to write")] = None,
    lights: Annotated[Path | None, typer.Option(help="changes of traffic lights, .csv")] = None,
    hdmap: Annotated[Path | None, typer.Option(help="lanelet2 map: lanes and stop lines")] = None,
) -> None:
    """Let agents drive by a policy among those who replay, and count what went wrong.

    Those who are not controlled do what the tracks say. Policies: constant-velocity,
    constant-turn-rate, idm (along the recorded way, keeping distance), replay.
    """
    from geoaim.simulation.episodes import simulate_scene
    from geoaim.simulation.scene import agent_number, tracks_of
    from geoaim.tracks import write_tracks

    with _stages() as progress, _plain_errors():
        _refuse_output(output)
        if film is not None and ego is None:
            raise ValueError("--film needs --ego, in whose middle the film is")
        scene, known, world = _scene(aim, tracks, lights, hdmap)
        episode = simulate_scene(scene, policy, ego=ego, start=start, seconds=seconds, hdmap=known)
        write_tracks(tracks_of(episode.scene, world), output)
        if film is not None and ego is not None:
            _film(episode.scene, agent_number(scene, ego), film, progress)
    rates = ", ".join(f"{name} {100 * share:.2f} %" for name, share in episode.rates.items())
    console.print(f"{output}: {int(episode.controlled.sum())} agents by {policy}. {rates}")


@app.command()
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

    with _stages() as progress, _plain_errors():
        check_folder(folder)
        progress("place", 0, 1)
        made = make_sample(seed, kind=kind, minutes=minutes, video=VIDEOS.get(video))
        write_sample(made, folder, progress=progress)
    console.print(f"{folder}: see {folder / 'README.md'}")


def _counted(
    frames: Iterator[Any], total: int, progress: Callable[[str, float, float | None], None]
) -> Iterator[Any]:
    """The frames, each reported."""
    for number, frame in enumerate(frames, 1):
        progress("render", number, total)
        yield frame


def _scene(
    aim: Path, tracks: Path, lights: Path | None, hdmap: Path | None
) -> tuple["Scene", "HDMap | None", "World"]:
    """A scene of files, and its HD map and world."""
    from geoaim.aim import read_aim
    from geoaim.lights import read_lights
    from geoaim.mapping.hdmap import read_hdmap
    from geoaim.simulation.scene import make_scene
    from geoaim.tracks import read_tracks

    if lights is not None and hdmap is None:
        raise ValueError("--lights needs --hdmap, where the stop lines are")
    place = read_aim(aim)
    known = None if hdmap is None else read_hdmap(hdmap, place.world)
    signals = None
    if lights is not None and known is not None:
        signals = read_lights(lights, known.stop_lines, known.world)
    return make_scene(place, read_tracks(tracks), signals), known, place.world


def _film(
    scene: "Scene",
    agent: int,
    path: Path,
    progress: Callable[[str, float, float | None], None],
    *,
    step: "Tensor | None" = None,
    size: int = 512,
    metres: float = 80.0,
    trail: float = 2.0,
) -> int:
    """Draw what an agent has around it at one step or at all of its steps; how many they were."""
    from geoaim.simulation.ground import View
    from geoaim.simulation.pictures import film_agent, write_pictures
    from geoaim.simulation.scene import step_seconds

    steps = scene.present[agent].nonzero()[:, 0] if step is None else step[None]
    frames = film_agent(scene, agent, View(size, size, metres / size), steps, trail=trail)
    write_pictures(_counted(frames, len(steps), progress), path, rate=1 / step_seconds(scene))
    return len(steps)


@contextmanager
def _stages() -> Iterator[Callable[[str, float, float | None], None]]:
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
    with Progress(*columns, console=console) as bars:

        def progress(stage: str, done: float, total: float | None) -> None:
            if stage not in tasks:
                for task in bars.task_ids:
                    bars.update(task, completed=bars.tasks[task].total or 1, total=1)
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield progress


@contextmanager
def _plain_errors() -> Iterator[None]:
    """Warnings as yellow lines; an error of the data as one red line and exit code 1."""
    with warnings.catch_warnings():
        warnings.simplefilter("always", GeoaimWarning)
        warnings.showwarning = _show_warning
        try:
            yield
        except (GeoaimError, OSError, ValueError) as error:
            console.print(Text.assemble((type(error).__name__, "bold red"), f": {error}"))
            sys.exit(1)


def _refuse_output(output: Path) -> None:
    """Find out before the work whether its result can be written."""
    if output.is_dir():
        raise ValueError(f"{output} is a folder; the name of a file is needed")
    folder = next(parent for parent in output.absolute().parents if parent.exists())
    if not folder.is_dir():
        raise ValueError(f"{folder} is a file; a folder is needed to write {output.name} into")
    if not os.access(folder, os.W_OK):
        raise ValueError(f"{folder} cannot be written to; choose another folder for {output.name}")


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    console.print(Text.assemble(("warning", "yellow"), f": {message}"))


def _count(text: str) -> int | Literal["auto", "all"]:
    if text == "auto":
        return "auto"
    if text == "all":
        return "all"
    if not text.isdigit() or int(text) < 1:
        raise typer.BadParameter(f"{text!r} is not auto, all or a number", param_hint="--frames")
    return int(text)


def _show(aim: "AIM", title: str) -> None:
    from geoaim.quicklook import summary

    table = Table(title=Text(title), show_header=False)
    for name, value in summary(aim).items():
        table.add_row(name, value)
    console.print(table)


if __name__ == "__main__":
    app()
