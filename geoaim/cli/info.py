"""The command that says what a file is: how each kind is recognised, described and used.

A describer takes a path and gives the kind, facts (value by name) and commands, in which FILE
stands for the path. `describe_file` chooses it by the suffix or the columns of a table, never by
trying to read a large file whole.
"""

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from geoaim.base.errors import GeoaimError
from geoaim.base.files import MAP_FILE, TRACKS_FILE, find_in_folder
from geoaim.cli import options
from geoaim.cli.console import console, print_result, report_errors


def info(
    source: Annotated[str, typer.Argument(help="file or folder of any kind that geoaim reads")],
    as_json: options.AsJson = False,
) -> None:
    """Say what a file or folder is, and which commands use it.

    It may be a video, images, a map (AIM), imagery, tracks, traffic lights, an HD map, control
    points, hand-drawn shapes, telemetry, detections, a texture, a registration, futures or a model.

    Example: geoaim info samples/tracks.csv
    """

    with report_errors():
        kind, facts, commands = describe_file(source)
        words = shlex.quote(source)
        calls = [f"geoaim {command.replace('FILE', words)}" for command in commands]
    if as_json:
        facts = {"kind": kind, **facts}
        print_result([Path(source)], facts, as_json, commands=calls)
        return
    print_result([Path(source)], {"kind": kind, **facts}, as_json)
    for call in calls:
        console.print(f"  {call}", highlight=False)


Facts = dict[str, str]
Description = tuple[str, Facts, tuple[str, ...]]

TIME_NAMES = {"time", "timestamp", "t", "frame", "frame_id"}  # properties of points of tracks
ID_NAMES = {"id", "track_id", "trackid", "agent_id", "vehicle_id", "object_id"}
IMAGES = {".png", ".jpg", ".jpeg"}
ON_A_MAP = "render map.tif --tracks tracks.csv --ego ID"
MAP_COMMANDS = (
    "view FILE",
    "view FILE --tracks tracks.csv",
    "texture FILE texture",
    "render FILE --tracks tracks.csv --ego ID -o view.mp4",
    "simulate FILE --tracks tracks.csv -o simulated.csv",
    "predict FILE --tracks tracks.csv -o futures.png",
    "train FILE --tracks tracks.csv -o model",
)
FOLDER_COMMANDS = ("view FILE", "predict FILE -o futures.png", "train FILE -o model")
VIDEO_COMMANDS = (
    "place FILE -o FOLDER",
    "build FILE --frame-resolution 0.05 -o map.tif",  # a first look
    "pick FILE -o points.csv",
    "pick FILE --imagery ortho.tif -o points.csv",
    "build FILE --points points.csv -o map.tif",
    "frame FILE -o frame.png",
    "register FILE -o registration.csv",
)
STILL_COMMAND = "build FILE --resolution 0.04 -o map.tif"
IMAGERY_COMMANDS = (
    "pick video.mp4 --imagery FILE -o points.csv",
    "align FILE --aim map.tif -o aligned.tif",
    "align FILE --tracks tracks.csv -o aligned.tif",
    "view map.tif --imagery FILE",
)
TRACK_COMMANDS = (
    "view map.tif --tracks FILE",
    "render map.tif --tracks FILE --ego ID -o view.mp4",
    "simulate map.tif --tracks FILE -o simulated.csv",
    "predict map.tif --tracks FILE -o futures.png",
    "align ortho.tif --tracks FILE -o map.tif",
)
LIGHT_COMMANDS = (
    "view map.tif --tracks tracks.csv --lights FILE --hdmap map.osm",
    f"{ON_A_MAP} --lights FILE --hdmap map.osm -o view.mp4",
)
LINE_COMMANDS = (f"{ON_A_MAP} --lights lights.csv --stop-lines FILE -o view.mp4",)
AREA_COMMANDS = (
    "view map.tif --drivable FILE",
    "simulate map.tif --tracks tracks.csv --drivable FILE -o simulated.csv",
)
FUTURE_COMMANDS = ("view map.tif --tracks tracks.csv --futures FILE",)


def describe_file(source: str) -> Description:
    """Describe a file, folder, pattern or address."""
    path = Path(source)
    if "://" in source:
        return "tile service", {}, IMAGERY_COMMANDS[:2]
    if not path.exists() and not any(sign in source for sign in "*?["):
        raise FileNotFoundError(f"{source}: no such file or folder")
    if path.is_dir():
        return _describe_folder(path)
    return DESCRIBERS.get(path.suffix.lower(), _describe_video)(source)


def _describe_folder(folder: Path) -> Description:
    if (folder / "texture.json").exists():
        return _describe_json(str(folder / "texture.json"))
    if (folder / "model.pt").exists():
        kind, facts, commands = _describe_model(str(folder / "model.pt"))
        inside = tuple(command.replace("FILE", "FILE/model.pt") for command in commands)
        return f"folder of a {kind}", facts, inside
    map_file, tracks_file = (find_in_folder(folder, name) for name in (MAP_FILE, TRACKS_FILE))
    if map_file != folder:
        _, facts, _ = _describe_raster(str(map_file))
        if tracks_file != folder:
            facts |= _describe_tracks(str(tracks_file))[1]
        return "folder of geoaim place", facts, FOLDER_COMMANDS
    describers = [_describe_tracks, _describe_imagery, _describe_video]
    rasters = any(file.suffix.lower() in (".tif", ".tiff") for file in folder.rglob("*"))
    if rasters:  # whatever lies beside them
        describers = [_describe_imagery, _describe_video]
    reason = None
    for describe in describers:
        try:
            return describe(str(folder))
        except (GeoaimError, FileNotFoundError) as error:
            reason = reason or error
    if rasters and reason is not None:
        raise reason
    if texts := list(folder.glob("*.txt")):
        facts = {"frames": str(len(texts))}
        command = "build video.mp4 --points points.csv --detections FILE -o map.tif"
        return "detections (YOLO)", facts, (command,)
    raise GeoaimError(
        f"{folder} holds nothing that geoaim reads as a folder: images, tiles, a SinD recording, "
        "detections (.txt), a texture or a model; name a single file in it"
    )


def _describe_raster(source: str) -> Description:
    """An AIM, imagery, or an image without a place."""
    from geoaim.aim.files import read_aim
    from geoaim.base.limits import refuse_damaged
    from geoaim.base.raster_files import open_raster_file

    with (
        refuse_damaged(source, GeoaimError, "a readable GeoTIFF"),
        open_raster_file(source) as file,
    ):
        is_aim, is_placed = "GEOAIM" in file.tags(), file.crs is not None
    if is_aim:
        return "AIM: a map", read_aim(source).summarize(), MAP_COMMANDS
    return _describe_imagery(source) if is_placed else _describe_video(source)


def _describe_image(source: str) -> Description:
    """An image: a texture's, or one that has a place where a world file lies beside it."""
    from geoaim.aim.texture_files import FRAME_FILE, PICTURE_FILE
    from geoaim.base.limits import refuse_damaged
    from geoaim.base.raster_files import read_georeference

    if Path(source).name == PICTURE_FILE and (frame := Path(source).with_name(FRAME_FILE)).exists():
        return _describe_json(str(frame))
    with refuse_damaged(source, GeoaimError, "a readable image"):
        placed = read_georeference(source)[0] is not None
    return _describe_imagery(source) if placed else _describe_video(source)


def _describe_imagery(source: str) -> Description:
    from geoaim.base.errors import ImageryError
    from geoaim.imagery.sources import describe_source

    try:
        layer = describe_source(source, None)
    except ImageryError as error:
        if "coordinate reference system" not in str(error):
            raise
        commands = tuple(f"{command} --crs EPSG:n" for command in IMAGERY_COMMANDS)
        return "imagery", {"CRS": "not stated: give --crs"}, commands
    first = layer.rasters[0]
    height, width = first.grid.shape
    facts = {"files": str(len(layer.rasters)), "first": f"{width} x {height} px, {first.crs}"}
    if layer.zoom is not None:
        facts["zoom"] = str(layer.zoom)
    return "imagery", facts, IMAGERY_COMMANDS


def _describe_video(source: str) -> Description:
    from geoaim.mapping.video.video import VIDEO_SUFFIXES, open_video, warn_of_pace

    try:
        video = open_video(source)
    except GeoaimError as error:
        if Path(source).suffix.lower() in VIDEO_SUFFIXES:
            raise
        raise GeoaimError(f"{source} is no file that geoaim reads: {error}") from error
    facts = {"size": f"{video.width} x {video.height} px"}
    if video.names is None:
        facts["length"] = f"{video.duration:.2f} s, {video.rate:.4g} frames/s"
        warn_of_pace(video)
        facts["telemetry"] = "yes" if video.telemetry is not None else "none"
        return "video", facts, VIDEO_COMMANDS
    if video.frame_count == 1:
        return "image", facts, (*VIDEO_COMMANDS[3:], STILL_COMMAND)
    return "images", {"number": str(video.frame_count), **facts}, VIDEO_COMMANDS


def _describe_table(source: str) -> Description:
    """A table, recognised by its columns; what has no known ones is tried as tracks."""
    columns = _read_columns(source)
    if {"m00", "m22"} <= columns:
        return "registration of the frames of a video", {}, ()
    if {"sample", "id", "time"} <= columns:
        return "futures that predict wrote", {}, FUTURE_COMMANDS
    has_lights = any("traffic light" in name or name == "movement_state" for name in columns)
    if has_lights or {"signal", "state"} <= columns:
        return _describe_lights(source)
    if _has_point_columns(columns) or Path(source).suffix.lower() in (".txt", ".points"):
        return _describe_points(source)
    return _describe_tracks(source)


def _has_point_columns(columns: set[str]) -> bool:
    from geoaim.mapping.georeference.point_files import COLUMN_NAMES

    return all(columns & set(COLUMN_NAMES[key]) for key in "uvxy")


def _read_columns(source: str) -> set[str]:
    """Read the names in a table's header, in lower case; empty where it has none."""
    from geoaim.base.limits import refuse_damaged

    with refuse_damaged(source, GeoaimError, "a readable table"):
        if source.lower().endswith(".parquet"):
            from pyarrow.parquet import read_schema

            return {name.lower() for name in read_schema(source).names}
        if source.lower().endswith(".gz"):
            return set()
        with open(source, encoding="utf-8-sig", errors="replace") as file:
            header = next((line for line in file if line.strip() and line[0] != "#"), "")
    return {name.strip(' "\n').lower() for name in re.split("[,;\t]", header)}


def _describe_tracks(source: str) -> Description:
    from geoaim.tracks.formats.formats import detect_format, read_tracks

    found = detect_format(source)
    name = f"tracks ({found.name} format)"
    if "resolution" not in found.required:
        return name, read_tracks(source).summarize(), TRACK_COMMANDS
    needs = {"units": "pixels: commands need --tracks-resolution, metres per pixel"}
    options = "--tracks-resolution 0.04"
    if "frame_rate" in found.options:
        options += " --tracks-frame-rate 29.97"
    commands = (f"{command} {options}" for command in TRACK_COMMANDS)
    return name, needs, tuple(commands)


def _describe_lights(source: str) -> Description:
    from geoaim.tracks.lights import read_light_changes

    rows = read_light_changes(source)
    signals = ", ".join(dict.fromkeys(rows["signal"]))
    times = f"{len(rows)} changes, {rows['time'].min():g} to {rows['time'].max():g} s"
    return "traffic lights", {"signals": signals, "states": times}, LIGHT_COMMANDS


def _describe_points(source: str) -> Description:
    from geoaim.mapping.georeference.point_files import read_point_file

    rows = read_point_file(Path(source))
    frames = ", ".join(dict.fromkeys(row.frame for row in rows if row.frame)) or "the first"
    crs = ", ".join(dict.fromkeys(row.crs for row in rows if row.crs)) or "not stated: give --crs"
    facts = {"points": str(len(rows)), "picked on frame": frames, "CRS": crs}
    return "control points", facts, ("build video.mp4 --points FILE -o map.tif",)


def _describe_hdmap(source: str) -> Description:
    from geoaim.hdmap.lanelet2 import read_hdmap

    commands = ("draw FILE -o map.tif", f"{ON_A_MAP} --lights lights.csv --hdmap FILE -o view.mp4")
    return "HD map (lanelet2)", read_hdmap(source).summarize(), commands


def _describe_model(source: str) -> Description:
    from geoaim.base.limits import refuse_damaged
    from geoaim.prediction.checkpoints import make_config, read_state

    state = read_state(source)
    with refuse_damaged(source, GeoaimError, "a model or a checkpoint of this version"):
        config = make_config(state["config"])
        facts = {"predicts": f"{config.kind}s, {config.dt:g} s a step"}
    if "optimiser" in state:
        return "training checkpoint", facts, ()
    commands = (
        "predict map.tif --tracks tracks.csv --weights FILE -o futures.png",
        "evaluate map.tif --tracks tracks.csv --weights FILE",
    )
    return "prediction model", facts, commands


def _describe_json(source: str) -> Description:
    from geoaim.aim.texture_files import read_frame
    from geoaim.base.limits import refuse_damaged

    with refuse_damaged(source, GeoaimError, "a corner frame or GeoJSON"):
        content = json.loads(Path(source).read_text(encoding="utf-8-sig"))
        if "type" in content:
            return _describe_shapes(source)
    frame, grid = read_frame(Path(source))
    size, crs = f"{grid.width} x {grid.height} px", frame["world"]["crs"] or "local plane"
    return "corner frame of a texture", {"image": f"{frame['image']}, {size}", "CRS": crs}, ()


def _describe_shapes(source: str) -> Description:
    from collections import Counter

    from geoaim.base.geojson import list_features

    features = list_features(source)
    kinds = Counter(shape.geometry.geom_type for shape in features)
    names = {name.lower() for shape in features[:1] for name in shape.properties}
    if set(kinds) <= {"Point"} and names & TIME_NAMES and names & ID_NAMES:
        facts = {"points": str(len(features)), "properties": ", ".join(sorted(names))}
        facts["read as"] = "GeoPackage or CSV: save it as one of these in QGIS, or by geopandas"
        return "tracks (GeoJSON points)", facts, ()
    facts = {"shapes": ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())}
    lines = LINE_COMMANDS if any("Line" in kind for kind in kinds) else ()
    areas = AREA_COMMANDS if any("Polygon" in kind for kind in kinds) else ()
    return "hand-drawn shapes (GeoJSON)", facts, (*lines, *areas)


def _describe_telemetry(source: str) -> Description:
    from geoaim.mapping.video.srt import read_srt

    telemetry = read_srt(source)
    facts = {"entries": str(len(telemetry.time)), "used for": "the video of the same name"}
    return "telemetry of a drone", facts, ()


DESCRIBERS: dict[str, Callable[[str], Description]] = {
    **dict.fromkeys((".tif", ".tiff"), _describe_raster),
    **dict.fromkeys(IMAGES, _describe_image),
    **dict.fromkeys((".csv", ".parquet", ".gz", ".txt", ".points"), _describe_table),
    **dict.fromkeys((".mbtiles", ".webp", ".vrt", ".jp2"), _describe_imagery),
    **dict.fromkeys((".pkl", ".gpkg"), _describe_tracks),
    ".osm": _describe_hdmap,
    ".pt": _describe_model,
    ".json": _describe_json,
    ".geojson": _describe_shapes,
    ".srt": _describe_telemetry,
}
