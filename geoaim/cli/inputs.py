"""Reading of the inputs that several commands share: tracks, scenes and prediction models."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from geoaim.cli.options import AgentKind

if TYPE_CHECKING:
    from geoaim.hdmap.lanelet2 import HDMap
    from geoaim.lights import Lights
    from geoaim.prediction.itra import ITRA
    from geoaim.simulation.scene import Scene
    from geoaim.tracks import Tracks
    from geoaim.web.explore import Contents
    from geoaim.world import World

DEFAULT_DURATIONS_S = {"vehicle": 4.0, "pedestrian": 8.0}  # that are predicted


@dataclass(frozen=True)
class SceneSource:
    """The files of a scene, by options; hand-drawn stop lines replace those of the HD map."""

    aim: Path
    tracks: Path | None
    tracks_world: str | None = None
    tracks_resolution: float | None = None
    lights: Path | None = None
    hdmap: Path | None = None
    stop_lines: Path | None = None


def read_any_tracks(path: Path, world: str | None, resolution: float | None) -> "Tracks":
    """Read tracks by `read_tracks`.

    Args:
        path: the file or folder.
        world: value of --tracks-world: a CRS and two numbers, or None.
        resolution: value of --tracks-resolution: metres per pixel, or None.

    Returns:
        The tracks.
    """
    from geoaim.track_formats import read_tracks

    plane = None if world is None else _parse_world(world)
    return read_tracks(path, world=plane, resolution=resolution)


def read_scene(
    source: SceneSource, *, rate: float | None = None
) -> tuple["Scene", "HDMap | None", "World"]:
    """Read a scene, its HD map (None without one) and its world; a rate (Hz) resamples tracks.

    Raises:
        ValueError: lights are given without the places of their stop lines, or the other way.
    """
    from geoaim.aim_files import read_aim
    from geoaim.hdmap.lanelet2 import read_hdmap
    from geoaim.limits import name_file
    from geoaim.simulation.scene import make_scene
    from geoaim.track_changes import resample_tracks

    _check_lights(source)
    if source.tracks is None:
        raise ValueError("a scene needs --tracks")
    aim = read_aim(source.aim)
    hdmap = None if source.hdmap is None else read_hdmap(source.hdmap, aim.world)
    lights = _read_lights(source, hdmap, aim.world)
    tracks = read_any_tracks(source.tracks, source.tracks_world, source.tracks_resolution)
    if rate is not None:
        tracks = resample_tracks(tracks, rate)
    with name_file(source.tracks):
        scene = make_scene(aim, tracks, lights)
    return scene, hdmap, aim.world


def read_contents(source: SceneSource, world: "World", drivable: Path | None = None) -> "Contents":
    """Read what the viewer shows on a map in a world; all but the map is optional."""
    from geoaim.hdmap.drivable import read_drivable_area
    from geoaim.hdmap.lanelet2 import read_hdmap
    from geoaim.web.explore import Contents

    _check_lights(source)
    hdmap = None if source.hdmap is None else read_hdmap(source.hdmap, world)
    tracks = None
    if source.tracks is not None:
        tracks = read_any_tracks(source.tracks, source.tracks_world, source.tracks_resolution)
    return Contents(
        tracks=tracks,
        lights=_read_lights(source, hdmap, world),
        hdmap=hdmap,
        drivable=None if drivable is None else read_drivable_area(drivable, world),
    )


def load_model(weights: Path | None, kind: AgentKind | None = None) -> "ITRA":
    """Load the model of a file; None: the pretrained one of the kind ("vehicles" if None).

    Raises:
        ValueError: the file's model predicts agents of another kind than the given one.
    """
    from geoaim.prediction.checkpoints import read_model, read_pretrained

    if weights is None:
        return read_pretrained((kind or "vehicles").removesuffix("s"))
    model = read_model(weights)
    kinds = f"{model.config.kind}s"
    if kind not in (None, kinds):
        raise ValueError(f"{weights} is a model of {kinds}; give --kind {kinds}")
    return model


def get_horizon(model: "ITRA", duration: float | None = None) -> int:
    """Get the number of steps, at least 1, in a predicted duration (s, rounded to steps).

    None: the horizon of the model's proposals, or else 4 s of vehicles and 8 s of pedestrians.
    """
    config = model.config
    if duration is None and config.horizon:
        return config.horizon
    duration = DEFAULT_DURATIONS_S[config.kind] if duration is None else duration
    return max(1, round(duration / config.dt))


def _check_lights(source: SceneSource) -> None:
    if source.lights is not None and source.hdmap is None and source.stop_lines is None:
        raise ValueError("--lights needs --hdmap or --stop-lines, for the places of the lights")
    if source.stop_lines is not None and source.lights is None:
        raise ValueError("--stop-lines needs --lights, for the states of the lights")


def _read_lights(source: SceneSource, hdmap: "HDMap | None", world: "World") -> "Lights | None":
    from geoaim.lights import read_lights, read_stop_lines

    if source.lights is None:
        return None
    lines = () if hdmap is None else hdmap.stop_lines
    if source.stop_lines is not None:
        lines = read_stop_lines(source.stop_lines, world)
    return read_lights(source.lights, lines, world)


def _parse_world(text: str) -> "World":
    from geoaim.world import World

    try:
        crs, *numbers = text.split()
        east, north = map(float, numbers or ("0", "0"))
    except ValueError as error:
        raise ValueError(
            f"--tracks-world {text!r} is not a CRS and two numbers, such as "
            "'EPSG:32632 459000 5428000'"
        ) from error
    return World(crs, (east, north))
