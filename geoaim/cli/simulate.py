"""Commands that render agents on a map and simulate them; the default size of a view."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from geoaim.base.progress import Progress, report_each
from geoaim.cli import options
from geoaim.cli.console import console, print_table, report_errors, show_progress
from geoaim.cli.inputs import SceneFiles, SceneSource, load_model, read_scene, take_scene_files
from geoaim.cli.outputs import TRACKS, check_output

if TYPE_CHECKING:
    from torch import Tensor

    from geoaim.rendering.scene import Scene
    from geoaim.simulation.episodes import Episode
    from geoaim.simulation.simulator import Traffic

PolicyName = Literal["idm", "itra", "constant-velocity", "constant-turn-rate", "replay"]
DEFAULT_SIZE_PX, DEFAULT_EXTENT_M = 512, 80.0  # sides of a view
# options of a simulation's video
VIDEO = {"size": DEFAULT_SIZE_PX, "extent": DEFAULT_EXTENT_M, "trail": 2.0}


@take_scene_files
def render(
    aim: options.AimFile,
    ego: Annotated[str, typer.Option(help="id of the agent at the centre")],
    output: Annotated[Path, options.output(".mp4, .gif or .png to write")],
    tracks: options.SceneTracks = None,
    size: Annotated[
        int, typer.Option(help="side of the view, px", min=16, max=4096)
    ] = DEFAULT_SIZE_PX,
    extent: Annotated[float, typer.Option(help="side of the view, m", min=1)] = DEFAULT_EXTENT_M,
    time: Annotated[
        float | None, typer.Option(help="time of a .png, s; the agent's first if omitted")
    ] = None,
    trail: Annotated[
        float, typer.Option(help="length of the trails behind the agents, s", min=0)
    ] = 0.0,
    *,
    files: SceneFiles,
) -> None:
    """Render the bird's-eye view of an agent: the map with all agents, heading up.

    Traffic lights are bars on their stop lines: --lights gives their states, --hdmap or
    --stop-lines their places.

    Example: geoaim render map.tif --tracks samples/tracks.csv --ego 12 -o view.mp4
    """
    from geoaim.rendering.scene import find_agent, find_agent_step

    with show_progress() as progress, report_errors():
        check_output(output, (".mp4", ".gif", ".png"))
        scene, _, _ = read_scene(SceneSource(aim, tracks, **files))
        agent = find_agent(scene, ego)
        steps = scene.present[agent].nonzero()[:, 0]
        if output.suffix.lower() == ".png":
            steps = find_agent_step(scene, agent, time)[None]
        view = {"size": size, "extent": extent, "trail": trail}
        _film_agent(scene, agent, steps, output, progress, **view)
    console.print(f"{output}: {len(steps)} images of {size} x {size} px around agent {ego}")


@take_scene_files
def simulate(
    aim: options.AimFile,
    output: Annotated[Path, options.output("simulated tracks, .csv or .parquet, to write")],
    tracks: options.SceneTracks = None,
    policy: Annotated[PolicyName, typer.Option(help="policy of the controlled agents")] = "idm",
    weights: Annotated[
        Path | None,
        typer.Option(help="model.pt of itra; the pretrained one of vehicles if omitted"),
    ] = None,
    seed: Annotated[int, typer.Option(help="random seed of itra", min=0)] = 0,
    ego: Annotated[
        str | None,
        typer.Option(
            help="id of the controlled agent; if omitted, all agents that never drive in reverse"
        ),
    ] = None,
    start: Annotated[
        float | None,
        typer.Option(help="time in the tracks at which to start, s; the first if omitted"),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            help="simulated time, s; 6 or up to the end of the tracks if omitted", min=0.1
        ),
    ] = None,
    film: Annotated[
        Path | None, typer.Option(help=".mp4 or .gif of the view around the ego to write")
    ] = None,
    drivable: options.DrivableFile = None,
    *,
    files: SceneFiles,
) -> None:
    """Simulate agents by a policy, and count infractions beside those of the recording.

    All agents that are not controlled replay their tracks. Policies: idm (intelligent driver
    model on the recorded path), itra (as the model drives), constant-velocity, constant-turn-rate,
    replay. --drivable and --stop-lines replace those of the HD map.

    Example: geoaim simulate map.tif --tracks samples/tracks.csv --hdmap samples/map.osm
    --lights samples/lights.csv -o simulated.csv
    """
    import torch

    from geoaim.base.files import atomic_files
    from geoaim.hdmap.drivable import read_drivable_area
    from geoaim.rendering.scene import find_agent, make_tracks
    from geoaim.simulation.episodes import simulate_scene
    from geoaim.simulation.road_rules import make_road_rules
    from geoaim.tracks.files import write_tracks

    with show_progress() as progress, report_errors():
        check_output(output, TRACKS, [aim, tracks, files["lights"]])
        if film is not None:
            check_output(film, (".mp4", ".gif"), [aim])
            if ego is None:
                raise ValueError("--film needs --ego, the agent at its centre")
        driver, rate = _load_driver(policy, weights)
        scene, roads, world = read_scene(SceneSource(aim, tracks, **files), rate=rate)
        area = None if drivable is None else read_drivable_area(drivable, world)
        rules = make_road_rules(roads, area, world=world)
        given: dict[str, Any] = {"ego": ego, "start": start, "duration": duration, "rules": rules}
        generator = torch.Generator().manual_seed(seed)
        episode = simulate_scene(scene, driver, generator=generator, **given)
        with atomic_files(output, *([] if film is None else [film])) as parts:
            write_tracks(make_tracks(episode.scene, world), parts[0])
            if film is not None and ego is not None:
                agent = find_agent(episode.scene, ego)
                steps = episode.scene.present[agent].nonzero()[:, 0]
                _film_agent(episode.scene, agent, steps, parts[1], progress, **VIDEO)
    title = f"{output}: {int(episode.controlled.sum())} agents by {policy}; shares of their steps:"
    print_table(title, _list_rates(episode))


def _load_driver(policy: str, weights: Path | None) -> "tuple[str | Traffic, float | None]":
    """Load the model of a policy that has one, and the rate of its steps, 1/s."""
    if policy != "itra":
        if weights is not None:
            raise ValueError(f"--weights are of a model, and {policy} has none; add --policy itra")
        return policy, None
    from geoaim.prediction.policies import make_traffic

    model = load_model(weights)
    return make_traffic(model), 1 / model.config.dt


def _list_rates(episode: "Episode") -> dict[str, str]:
    """List the rates of a simulation beside those of its recording."""
    both = episode.rates, episode.recorded_rates
    names = dict.fromkeys(name for rates in both for name in rates)
    return {
        name: ", recorded ".join(
            f"{100 * rates[name]:.3g} %" if name in rates else "not counted" for rates in both
        )
        for name in names
    }


def _film_agent(
    scene: "Scene", agent: int, steps: "Tensor", path: Path, progress: Progress, **view: float
) -> None:
    """Write the view around an agent: its size (px), its extent (m) and its trail (s)."""
    from geoaim.rendering.ground import View
    from geoaim.rendering.pictures import render_agent_video, write_pictures

    size = int(view["size"])
    square = View(size, size, view["extent"] / size)
    frames = render_agent_video(scene, agent, square, steps, trail=view["trail"])
    reported = report_each(frames, progress, "render", len(steps))
    write_pictures(reported, path, frame_rate=1 / scene.dt)
