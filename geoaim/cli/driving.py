"""Commands that draw traffic on maps and simulate it."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from geoaim.cli.console import (
    AimFile,
    TracksFile,
    TracksPixel,
    TracksWorld,
    console,
    plain_errors,
    read_any_tracks,
    refuse_output,
    stages,
)
from geoaim.progress import Progress

if TYPE_CHECKING:
    from torch import Tensor

    from geoaim.hdmap.lanelet2 import HDMap
    from geoaim.simulation.scene import Scene
    from geoaim.world import World

PolicyName = Literal["idm", "constant-velocity", "constant-turn-rate", "replay"]
LightsFile = Annotated[Path | None, typer.Option(help="changes of traffic lights, .csv")]
HDMapFile = Annotated[Path | None, typer.Option(help="lanelet2 map with the lights' stop lines")]
EGO = "id of who drives; if left out all but those who ever reverse, who replay"
StopLinesFile = Annotated[
    Path | None, typer.Option(help="stop lines drawn by hand, GeoJSON lines with a 'signal' each")
]


def render(
    aim: AimFile,
    tracks: TracksFile,
    ego: Annotated[str, typer.Option(help="id of the agent in the middle, heading up")],
    output: Annotated[Path, typer.Option("--output", "-o", help=".mp4, .gif or .png to write")],
    size: Annotated[int, typer.Option(help="pixels of each side", min=16, max=4096)] = 512,
    metres: Annotated[float, typer.Option(help="metres of each side", min=1)] = 80.0,
    time: Annotated[float | None, typer.Option(help="s, of a .png; the first if left out")] = None,
    lights: LightsFile = None,
    hdmap: HDMapFile = None,
    stop_lines: StopLinesFile = None,
    trail: Annotated[float, typer.Option(help="s of everybody's way to draw", min=0)] = 0.0,
    tracks_world: TracksWorld = None,
    tracks_resolution: TracksPixel = None,
) -> None:
    """Draw what an agent has around it: the map, heading up, with all agents on it.

    Traffic lights are bars on their stop lines; --lights has states, --hdmap or --stop-lines lines.
    """
    from geoaim.simulation.scene import agent_number, step_at

    with stages() as progress, plain_errors():
        refuse_output(output, (".mp4", ".gif", ".png"))
        agents = (tracks, tracks_world, tracks_resolution)
        scene, _, _ = read_scene(aim, agents, lights, hdmap, stop_lines)
        agent = agent_number(scene, ego)
        step = step_at(scene, agent, time) if output.suffix.lower() == ".png" else None
        count = _film(
            scene, agent, output, progress, step=step, size=size, metres=metres, trail=trail
        )
    console.print(f"{output}: {count} pictures of {size} x {size} px around agent {ego}")


def simulate(
    aim: AimFile,
    tracks: TracksFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="tracks to write, .csv or .parquet")
    ],
    policy: Annotated[PolicyName, typer.Option(help="who drives")] = "idm",
    ego: Annotated[str | None, typer.Option(help=EGO)] = None,
    start: Annotated[
        float | None, typer.Option(help="s of the tracks at which it begins; the first if left out")
    ] = None,
    seconds: Annotated[float, typer.Option(help="to simulate", min=0.1)] = 6.0,
    film: Annotated[Path | None, typer.Option(help=".mp4 or .gif around the ego to write")] = None,
    lights: LightsFile = None,
    hdmap: Annotated[Path | None, typer.Option(help="lanelet2 map: lanes and stop lines")] = None,
    stop_lines: StopLinesFile = None,
    drivable: Annotated[
        Path | None, typer.Option(help="polygons in which vehicles may drive, GeoJSON")
    ] = None,
    tracks_world: TracksWorld = None,
    tracks_resolution: TracksPixel = None,
) -> None:
    """Let agents drive by a policy among those who replay, and count what went wrong.

    Those who are not controlled do what the tracks say. Policies: constant-velocity,
    constant-turn-rate, idm (along the recorded way, keeping distance), replay. --drivable and
    --stop-lines are drawn by hand, where there is no HD map or in its place.
    """
    from geoaim.hdmap.drivable import read_drivable_area
    from geoaim.simulation.episodes import rules_of, simulate_scene
    from geoaim.simulation.scene import agent_number, tracks_of
    from geoaim.track_files import write_tracks

    with stages() as progress, plain_errors():
        refuse_output(output, (".csv", ".parquet"), [aim, tracks, lights])
        if film is not None:
            refuse_output(film, (".mp4", ".gif"), [aim])
            if ego is None:
                raise ValueError("--film needs --ego, in whose middle the film is")
        agents = (tracks, tracks_world, tracks_resolution)
        scene, known, world = read_scene(aim, agents, lights, hdmap, stop_lines)
        area = None if drivable is None else read_drivable_area(drivable, world)
        rules = rules_of(known, area)
        episode = simulate_scene(scene, policy, ego=ego, start=start, seconds=seconds, rules=rules)
        write_tracks(tracks_of(episode.scene, world), output)
        if film is not None and ego is not None:
            _film(episode.scene, agent_number(scene, ego), film, progress)
    rates = ", ".join(f"{name} {100 * share:.2f} %" for name, share in episode.rates.items())
    rates = rates or "nothing could be counted"
    console.print(f"{output}: {int(episode.controlled.sum())} agents by {policy}. {rates}")


def read_scene(
    aim: Path,
    tracks: tuple[Path, str | None, float | None],
    lights: Path | None,
    hdmap: Path | None,
    stop_lines: Path | None,
    *,
    rate: float | None = None,
) -> tuple["Scene", "HDMap | None", "World"]:
    """A scene of files, and its HD map and world; tracks with their world and metres per pixel.

    At a rate in Hz, if one is given.
    """
    from geoaim.aim_files import read_aim
    from geoaim.hdmap.lanelet2 import read_hdmap
    from geoaim.lights import read_lights, read_stop_lines
    from geoaim.simulation.scene import make_scene
    from geoaim.track_changes import resample_tracks

    if lights is not None and hdmap is None and stop_lines is None:
        raise ValueError("--lights needs --hdmap or --stop-lines: where they stop traffic")
    if stop_lines is not None and lights is None:
        raise ValueError("--stop-lines needs --lights: which state they show")
    place = read_aim(aim)
    known = None if hdmap is None else read_hdmap(hdmap, place.world)
    lines = () if known is None else known.stop_lines
    if stop_lines is not None:
        lines = read_stop_lines(stop_lines, place.world)
    signals = None if lights is None else read_lights(lights, lines, place.world)
    agents = read_any_tracks(*tracks)
    if rate is not None:
        agents = resample_tracks(agents, rate)
    return make_scene(place, agents, signals), known, place.world


def _film(
    scene: "Scene",
    agent: int,
    path: Path,
    progress: Progress,
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


def _counted(frames: Iterator[Any], total: int, progress: Progress) -> Iterator[Any]:
    """The frames, each reported."""
    for number, frame in enumerate(frames, 1):
        progress("render", number, total)
        yield frame
