"""Reading of the inputs that several commands share: tracks, and scenes from several files."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from geoaim.hdmap.lanelet2 import HDMap
    from geoaim.lights import Lights
    from geoaim.simulation.scene import Scene
    from geoaim.tracks import Tracks
    from geoaim.world import World


@dataclass(frozen=True)
class TracksSource:
    """A file of tracks, with the values of --tracks-world and --tracks-resolution."""

    path: Path
    world: str | None = None
    resolution: float | None = None


@dataclass(frozen=True)
class SceneSource:
    """The files of a scene; hand-drawn stop lines replace those of the HD map."""

    aim: Path
    tracks: TracksSource
    lights: Path | None = None
    hdmap: Path | None = None
    stop_lines: Path | None = None


def read_tracks_source(source: TracksSource) -> "Tracks":
    """Read tracks in any known format, in the world of --tracks-world if one is given."""
    from geoaim.track_formats import read_tracks

    world = None if source.world is None else _parse_world(source.world)
    return read_tracks(source.path, world=world, resolution=source.resolution)


def read_scene(
    source: SceneSource, *, rate: float | None = None
) -> tuple["Scene", "HDMap | None", "World"]:
    """Read a scene, its HD map and its world; tracks are resampled if a rate in Hz is given."""
    from geoaim.aim_files import read_aim
    from geoaim.hdmap.lanelet2 import read_hdmap
    from geoaim.simulation.scene import make_scene
    from geoaim.track_changes import resample_tracks

    if source.lights is not None and source.hdmap is None and source.stop_lines is None:
        raise ValueError("--lights needs --hdmap or --stop-lines, for the places of the lights")
    if source.stop_lines is not None and source.lights is None:
        raise ValueError("--stop-lines needs --lights, for the states of the lights")
    aim = read_aim(source.aim)
    hdmap = None if source.hdmap is None else read_hdmap(source.hdmap, aim.world)
    lights = _read_lights(source, hdmap, aim.world)
    tracks = read_tracks_source(source.tracks)
    if rate is not None:
        tracks = resample_tracks(tracks, rate)
    return make_scene(aim, tracks, lights), hdmap, aim.world


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
