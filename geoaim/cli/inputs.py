"""Read the inputs that several commands share: tracks, scenes, tables of scenes, and models."""

import csv
import inspect
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geoaim.base.csv_rows import parse_number, read_rows
from geoaim.base.errors import TracksError, warn
from geoaim.base.progress import Progress
from geoaim.cli import options
from geoaim.cli.options import AgentKind

if TYPE_CHECKING:
    from geoaim.aim.aim import AIM
    from geoaim.base.world import World
    from geoaim.hdmap.lanelet2 import HDMap
    from geoaim.prediction.itra import ITRA
    from geoaim.rendering.ground import Ground
    from geoaim.rendering.scene import Scene
    from geoaim.tracks.lights import Lights
    from geoaim.tracks.tracks import Tracks
    from geoaim.web.explore import Contents

# how long futures are predicted
DEFAULT_DURATIONS_S = {"vehicle": 4.0, "pedestrian": 8.0, "cyclist": 6.0}


@dataclass(frozen=True)
class SceneSource:
    """The files of a scene, by options; hand-drawn stop lines replace those of the HD map."""

    aim: Path
    tracks: Path | None
    lights: options.LightsFile = None
    hdmap: options.HDMapFile = None
    stop_lines: options.StopLinesFile = None
    tracks_world: options.TracksWorld = None
    tracks_resolution: options.TracksResolution = None
    tracks_frame_rate: options.TracksFrameRate = None


SceneFiles = Mapping[str, Any]  # the fields of `SceneSource` but for aim and tracks


def read_any_tracks(
    path: Path,
    world: str | None = None,
    resolution: float | None = None,
    frame_rate: float | None = None,
) -> "Tracks":
    """Read tracks with the options of a command."""
    from geoaim.tracks.formats import read_tracks

    plane = None if world is None else parse_world(world)
    return read_tracks(path, world=plane, resolution=resolution, frame_rate=frame_rate)


def read_scene(
    source: SceneSource, *, rate: float | None = None
) -> tuple["Scene", "HDMap | None", "World"]:
    """Read a scene, its HD map (None without one) and its world; a rate (Hz) resamples tracks."""
    from geoaim.aim.texture_files import read_map
    from geoaim.base.limits import name_file
    from geoaim.hdmap.lanelet2 import read_hdmap
    from geoaim.rendering.scene import make_scene
    from geoaim.tracks.changes import resample_tracks

    _check_lights(source.lights, source.stop_lines, source.hdmap)
    if source.tracks is None:
        raise ValueError("a scene needs --tracks")
    aim = read_map(source.aim)
    hdmap = None if source.hdmap is None else read_hdmap(source.hdmap, aim.world)
    lights = read_any_lights(source.lights, source.stop_lines, hdmap, aim.world)
    tracks = _read_source_tracks(source, source.tracks)
    with name_file(source.tracks):
        if rate is not None:
            tracks = resample_tracks(tracks, rate)
        scene = make_scene(aim, tracks, lights)
    return scene, hdmap, aim.world


def read_contents(source: SceneSource, world: "World", drivable: Path | None = None) -> "Contents":
    """Read what the viewer shows on a map in a world; all but the map is optional."""
    from geoaim.hdmap.drivable import read_drivable_area
    from geoaim.hdmap.lanelet2 import read_hdmap
    from geoaim.web.explore import Contents

    _check_lights(source.lights, source.stop_lines, source.hdmap)
    hdmap = None if source.hdmap is None else read_hdmap(source.hdmap, world)
    tracks = None
    if source.tracks is not None:
        tracks = _read_source_tracks(source, source.tracks)
    return Contents(
        tracks=tracks,
        lights=read_any_lights(source.lights, source.stop_lines, hdmap, world),
        hdmap=hdmap,
        drivable=None if drivable is None else read_drivable_area(drivable, world),
    )


def _read_source_tracks(source: SceneSource, path: Path) -> "Tracks":
    options = source.tracks_world, source.tracks_resolution, source.tracks_frame_rate
    return read_any_tracks(path, *options)


def load_model(weights: Path | None, kind: AgentKind | None = None) -> "ITRA":
    """Load the model of a file; None: the pretrained one of `kind` ("vehicles" if None)."""
    from geoaim.prediction.checkpoints import read_model, read_pretrained

    if weights is None:
        kind = kind or "vehicles"
        if kind not in ("vehicles", "pedestrians"):
            raise ValueError(
                f"no model of {kind} comes with geoaim; train one with geoaim train --kind {kind} "
                "--scratch, and give --weights"
            )
        return read_pretrained(kind.removesuffix("s"))
    model = read_model(weights)
    kinds = f"{model.config.kind}s"
    if kind not in (None, kinds):
        raise ValueError(f"{weights} is a model of {kinds}; give --kind {kinds}")
    return model


def get_horizon(model: "ITRA", duration: float | None = None) -> int:
    """Get the number of steps, at least 1, in a predicted duration (s, rounded to steps)."""
    config = model.config
    if duration is None and config.horizon:
        return config.horizon
    duration = DEFAULT_DURATIONS_S[config.kind] if duration is None else duration
    return max(1, round(duration / config.dt))


def read_any_aim(path: Path, sources: Any, crs: str | None, margin: float) -> "AIM":
    """Read an AIM, or imagery in its stated place as an AIM: the part that others may show.

    These are `sources`, as `read_imagery` takes them, with their CRS where they name none; so many
    metres around them are read too.
    """
    import numpy as np
    from rasterio.errors import RasterioError

    from geoaim.aim.files import read_aim
    from geoaim.base.errors import ImageryError
    from geoaim.base.files import MAP_FILE, find_in_folder
    from geoaim.base.raster_files import open_raster_file
    from geoaim.base.world import choose_world, world_from_lonlat
    from geoaim.imagery.mosaic import read_imagery, read_lonlat

    file = find_in_folder(path, MAP_FILE)
    try:
        with open_raster_file(file) as raster:
            is_imagery = "GEOAIM" not in raster.tags() and raster.crs is not None
    except (OSError, RasterioError):  # read_aim says what is wrong
        is_imagery = False
    if not is_imagery:
        return read_aim(file)
    try:
        shown = read_lonlat(sources, crs)
    except ImageryError:  # a service of all the Earth, or a picture without a place
        return read_imagery(file)
    whole = read_lonlat(str(file), None)
    world = choose_world(whole)
    wanted, bounds = (
        np.stack([points.min(axis=0), points.max(axis=0)])
        for points in (world_from_lonlat(world, shown), world_from_lonlat(world, whole))
    )
    corners = np.clip(wanted + np.array([[-margin], [margin]]), *bounds)
    if not np.ptp(corners, axis=0).all():  # elsewhere, which the alignment says
        return read_imagery(file)
    return read_imagery(file, world=world, corners=corners)


def read_any_lights(
    lights: Path | None, stop_lines: Path | None, hdmap: "HDMap | None", world: "World"
) -> "Lights | None":
    """Read traffic lights, with hand-drawn stop lines or those of an HD map."""
    from geoaim.tracks.lights import read_lights, read_stop_lines

    _check_lights(lights, stop_lines, hdmap)
    if lights is None:
        return None
    lines = () if hdmap is None else hdmap.stop_lines
    if stop_lines is not None:
        lines = read_stop_lines(stop_lines, world)
    return read_lights(lights, lines, world)


def _check_lights(lights: Path | None, stop_lines: Path | None, hdmap: object | None) -> None:
    if lights is not None and hdmap is None and stop_lines is None:
        raise ValueError("--lights needs --hdmap or --stop-lines, for the places of the lights")
    if stop_lines is not None and lights is None:
        raise ValueError("--stop-lines needs --lights, for the states of the lights")


def parse_world(text: str) -> "World":
    """Parse the value of --tracks-world: a CRS and two numbers."""
    from geoaim.base.world import World

    try:
        crs, *numbers = text.split()
        east, north = map(float, numbers or ("0", "0"))
    except ValueError as error:
        raise ValueError(
            f"--tracks-world {text!r} is not a CRS and two numbers, such as "
            "'EPSG:32632 459000 5428000'"
        ) from error
    return World(crs, (east, north))


def take_scene_files(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of a scene's files, last, in place of its parameter `files`."""
    own, kind = inspect.signature(command), inspect.Parameter.KEYWORD_ONLY
    shared = [
        inspect.Parameter(field.name, kind, default=None, annotation=field.type)
        for field in fields(SceneSource)[2:]
    ]
    kept = [parameter for name, parameter in own.parameters.items() if name != "files"]
    signature = own.replace(parameters=[*kept, *shared])

    @wraps(command)
    def run(*args: object, **kwargs: object) -> None:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        files = {option.name: bound.arguments.pop(option.name) for option in shared}
        _open_folder(bound.arguments, files)
        command(**bound.arguments, files=files)

    run.__signature__ = signature  # type: ignore[attr-defined]  # typer reads both
    run.__annotations__ = {p.name: p.annotation for p in signature.parameters.values()}
    return run


def _open_folder(arguments: dict[str, Any], files: dict[str, Any]) -> None:
    """Take the map, the tracks and the roads of a folder that `geoaim place` wrote, if given."""
    from geoaim.base.files import MAP_FILE, ROAD_FILES, TRACKS_FILE, find_in_folder

    given = arguments.get("aim") or next(iter(arguments.get("maps") or ()), None)
    if given is None or find_in_folder(given, MAP_FILE) == given:
        return
    if arguments["tracks"] is None and find_in_folder(given, TRACKS_FILE) != given:
        arguments["tracks"] = given / TRACKS_FILE
        # its lights are of its own times
        files |= find_roads(given, {k: v for k, v in files.items() if k in ROAD_FILES})
    if "aim" in arguments:
        arguments["aim"] = given / MAP_FILE


def find_roads(folder: Path, given: Mapping[str, Path | None]) -> dict[str, Path | None]:
    """Find the lights, the HD map and the stop lines in a folder of `geoaim place`; others win."""
    from geoaim.base.files import ROAD_FILES, find_in_folder

    found = {name: find_in_folder(folder, ROAD_FILES[name]) for name in given}
    return {name: given[name] or (None if file == folder else file) for name, file in found.items()}


def find_video(aim: Path) -> Path | None:
    """Find the video of a map in a folder of `geoaim place` by its report, if it is still there."""
    from geoaim.base.files import REPORT_FILE
    from geoaim.mapping.video.video import find_video_file

    try:
        report = json.loads((aim.parent / REPORT_FILE).read_text(encoding="utf-8"))
        return find_video_file(report["video"])
    except (OSError, ValueError, KeyError, TypeError):  # of another program, or an earlier version
        return None


COLUMNS = tuple(field.name for field in fields(SceneSource))
NEEDED = ("aim", "tracks")
FILES = ("aim", "tracks", "lights", "hdmap", "stop_lines")
NUMBERS = ("tracks_resolution", "tracks_frame_rate")


def lists_recordings(path: Path) -> bool:
    """Tell whether a path is no map, but a table of recordings or a catalogue."""
    return path.suffix.lower() == ".csv" or (path / "recordings").is_dir()


def read_scene_sources(path: Path) -> list[SceneSource]:
    """Read a CSV with the columns `aim` and `tracks`, and other fields of `SceneSource`.

    Of a folder of `geoaim catalog build`, all recordings that have a map and tracks.
    """
    if path.is_dir():
        return _read_catalog(path)
    with open(path, encoding="utf-8-sig", newline="") as file:
        try:
            header, rows = read_rows(file)
        except (ValueError, csv.Error) as error:
            raise TracksError(f"{path} is not a CSV of recordings: {error}") from error
    if not set(NEEDED) <= set(header) <= set(COLUMNS) or len(set(header)) < len(header):
        raise TracksError(
            f"{path} has the columns {', '.join(header)}; needed are {' and '.join(NEEDED)}, "
            f"allowed are {', '.join(COLUMNS)}, each once"
        )
    if not rows:
        raise TracksError(f"{path} has no rows; give one for each recording")
    sources = []
    for number, cells in rows:
        try:
            sources.append(_parse_row(cells, path.parent))
        except ValueError as error:
            raise TracksError(f"{path}, line {number}: {error}") from error
    return sources


def _read_catalog(folder: Path) -> list[SceneSource]:
    """List the recordings of a catalogue that have tracks; say which ones have none."""
    from geoaim.catalog.pipeline import read_catalog
    from geoaim.catalog.records import FOLDER, MAP, TRACKS

    records = read_catalog(folder).records
    names = [name for name, record in records.items() if TRACKS in record.files]
    places = [folder / FOLDER / name for name in names]
    sources = [SceneSource(place / MAP, place / TRACKS) for place in places]
    if not sources:
        raise TracksError(
            f"no recording of {folder} has tracks: give its table a column tracks with `video` or "
            "files, and build it again"
        )
    if others := sorted(records.keys() - set(names)):
        warn(f"recordings without map or tracks are left out: {', '.join(others)}")
    return sources


def read_scenes(
    sources: list[SceneSource], rate: float, progress: Progress, *, skip: bool = False
) -> list["Scene"]:
    """Read scenes; those of one map share its ground, so that it is kept once.

    With `skip`, those whose tracks cannot be used are left out with a warning, unless none is left.
    """
    grounds: dict[Path, Ground] = {}
    scenes: list[Scene] = []
    for number, source in enumerate(sources):
        progress("read", number, len(sources))
        try:
            scene, _, _ = read_scene(source, rate=rate)
        except TracksError as error:
            if not skip or (number == len(sources) - 1 and not scenes):
                raise
            warn(f"a recording is left out: {error}")
            continue
        scenes.append(replace(scene, ground=grounds.setdefault(source.aim.resolve(), scene.ground)))
    progress("read", len(sources), len(sources))
    return scenes


def _parse_row(cells: Mapping[str, str], folder: Path) -> SceneSource:
    missing = [name for name in NEEDED if name not in cells]
    if missing:
        raise ValueError(f"it names no {missing[0]}")
    files = {name: folder / cells[name] for name in FILES if name in cells}
    numbers = {name: parse_number(name, cells[name]) for name in NUMBERS if name in cells}
    texts = {"tracks_world": cells["tracks_world"]} if "tracks_world" in cells else {}
    return SceneSource(**files, **numbers, **texts)  # type: ignore[arg-type]
