"""Commands that make tracks from a video, and read those of others."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from geoaim.base.errors import warn
from geoaim.cli import options
from geoaim.cli.console import console, print_result, report_errors, show_progress
from geoaim.cli.inputs import find_roads, find_video, read_any_lights, read_any_tracks
from geoaim.cli.outputs import TRACKS, check_output

if TYPE_CHECKING:
    from geoaim.tracks.tracks import Tracks


def track(
    video: options.VideoSources,
    aim: Annotated[Path, typer.Option(help="AIM of the same ground, best one of this video")],
    output: Annotated[Path, options.output(".csv or .parquet to write")],
    detections: Annotated[
        Path | None,
        typer.Option(
            help="boxes of a detector: a folder of YOLO .txt, MOT, COCO .json, .csv; "
            "geoaim finds the vehicles if omitted"
        ),
    ] = None,
    columns: Annotated[
        str | None, typer.Option(help="columns of a .csv, such as frame=frame,x=u_px,y=v_px")
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(help="frames per second by which the file's frame numbers count", min=0.01),
    ] = None,
    classes: Annotated[
        str, typer.Option(help="names of class numbers: car,van,bus from 0 on, or 3=car,4=bus")
    ] = "",
    form: Annotated[
        str | None, typer.Option(help="the four numbers of a box: ltrb, ltwh or xywh (the middle)")
    ] = None,
    size: Annotated[
        str | None, typer.Option(help="WIDTHxHEIGHT of the pictures that boxes are of, pixels")
    ] = None,
    first: Annotated[
        int | None, typer.Option(help="number of the first frame in the file", min=0)
    ] = None,
    image_rate: options.ImageRate = None,
    hdmap: options.HDMapFile = None,
    as_json: options.AsJson = False,
    flying_height: Annotated[
        float | None,
        typer.Option(help="of the camera above the ground, m: corrects roofs", min=10.0),
    ] = None,
) -> None:
    """Track the agents of a video on its map, from a detector's boxes or without any.

    The frames are registered to the map, which takes the boxes to metres on the ground. Tracks
    bridge misses of up to ten seconds, and longer ones of what stands, and are smoothed; the states
    that were known at each time are in columns of their own. Without --detections, vehicles that
    move, came or left are found
    by what differs from the map, which must be one of this video.

    Example: geoaim track samples/hover.mp4 --aim map.tif --detections samples/boxes -o tracks.csv
    """
    from geoaim.aim.files import read_aim
    from geoaim.hdmap.lanelet2 import read_hdmap
    from geoaim.mapping.video.detection_checks import parse_size
    from geoaim.mapping.video.detection_columns import parse_columns
    from geoaim.mapping.video.detections import read_detections
    from geoaim.mapping.video.video import open_video
    from geoaim.tracking.pipeline import track_video
    from geoaim.tracking.report import WITHOUT_DETECTOR, summarize_tracking
    from geoaim.tracking.roofs import describe_roofs
    from geoaim.tracks.files import write_tracks

    with show_progress() as progress, report_errors():
        check_output(output, TRACKS, [aim, hdmap])
        names = tuple(name.strip() for name in classes.split(",") if name.strip())
        chosen = None if columns is None else parse_columns(columns)
        opened = open_video(video, rate=image_rate or 1.0)
        boxes = None
        if detections is not None:
            boxes = read_detections(
                detections,
                columns=chosen,
                rate=rate,
                classes=names,
                form=form,
                size=None if size is None else parse_size(size),
                first=first,
                video=opened,
            )
        elif names or (columns, rate, form, size, first) != (None,) * 5:
            raise ValueError(
                "--columns, --rate, --classes, --form, --size and --first say how --detections is "
                "read; give it too, or leave them out"
            )
        ground = read_aim(aim)
        hdmap = find_roads(aim, {"hdmap": hdmap})["hdmap"]
        lanes = None if hdmap is None else read_hdmap(hdmap, ground.world)
        tracks = track_video(
            opened, ground, boxes, hdmap=lanes, flying_height=flying_height, progress=progress
        )
        write_tracks(tracks, output)
    lines = summarize_tracking(tracks, ground)
    if detections is None:
        lines["detections"] = WITHOUT_DETECTOR
    else:
        lines["roofs"] = describe_roofs(flying_height, opened.telemetry)
    print_result([output], lines, as_json)


FORMATS = {".csv": "plain", ".parquet": "plain", ".gpkg": "GeoPackage", "": "ScenarioNet"}
DATED = (".parquet", ".gpkg")


def convert(
    tracks: Annotated[
        list[Path],
        typer.Argument(help=f"{options.TRACKS_HELP}; several of one recording are merged"),
    ],
    output: Annotated[Path, options.output(".csv, .parquet or .gpkg, or a new folder, to write")],
    rate: Annotated[
        float | None, typer.Option(help="resample to this rate, Hz; ScenarioNet needs 10")
    ] = None,
    start: Annotated[
        float | None, typer.Option(help="time at which to start, s; the first if omitted")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="time to keep, s; all if omitted", min=0.0)
    ] = None,
    ego: Annotated[
        str | None, typer.Option(help="ScenarioNet: id of the agent that MetaDrive drives")
    ] = None,
    start_date: Annotated[
        str | None,
        typer.Option(
            help=".gpkg and .parquet: date and time at which time is 0; that of the file or of "
            "its video if omitted, else 1970-01-01"
        ),
    ] = None,
    lights: options.LightsFile = None,
    hdmap: options.HDMapFile = None,
    stop_lines: options.StopLinesFile = None,
    tracks_world: options.TracksWorld = None,
    tracks_resolution: options.TracksResolution = None,
    tracks_frame_rate: options.TracksFrameRate = None,
) -> None:
    """Write tracks in another format: plain, GeoPackage or ScenarioNet.

    Files of one recording, such as one of vehicles and one of pedestrians, are merged.

    A name that ends in .csv or .parquet is the plain format, .gpkg a GeoPackage, and a folder
    ScenarioNet, with the lanes and lights of --hdmap and --lights.

    Example: geoaim convert samples/tracks.csv -o tracks.gpkg
    """
    from geoaim.hdmap.lanelet2 import read_hdmap
    from geoaim.hdmap.scenarionet import write_scenarionet
    from geoaim.tracks.changes import merge_tracks
    from geoaim.tracks.files import write_tracks

    with report_errors():
        suffix, dates = output.suffix.lower(), ""
        if suffix not in FORMATS:
            raise ValueError(f"{output}: give a name that ends in .csv, .parquet or .gpkg")
        if start_date is not None and suffix not in DATED:
            raise ValueError("--start-date gives dates; name the output .gpkg or .parquet")
        if suffix:
            check_output(output, (suffix,), tracks)
        given = tracks_world, tracks_resolution, tracks_frame_rate
        read = merge_tracks([read_any_tracks(path, *given) for path in tracks])
        read = _change_times(read, rate, start, duration)
        if FORMATS[suffix] != "plain":
            _warn_of_derived_states(read, tracks)
        if suffix in DATED:
            begin, reason = _find_start(tracks) if start_date is None else (start_date, "given")
            dates = f"; time 0 is {begin} ({reason})"
            write_tracks(read, output, start=begin)
        elif suffix:
            write_tracks(read, output)
        else:
            files = {"lights": lights, "hdmap": hdmap, "stop_lines": stop_lines}
            lights, hdmap, stop_lines = find_roads(tracks[0], files).values()
            roads = None if hdmap is None else read_hdmap(hdmap, read.world)
            known = read_any_lights(lights, stop_lines, roads, read.world)
            write_scenarionet(read, output, hdmap=roads, lights=known, ego=ego)
    count = f"{len(read.ids)} agents at {len(read.times)} times"
    console.print(f"{output}: {count} ({FORMATS[suffix]}){dates}", highlight=False)


def _find_start(paths: list[Path]) -> tuple[str, str]:
    """Find when `time` was 0, and how that is known: by the first file that says it."""
    from geoaim.base.files import TRACKS_FILE, find_in_folder
    from geoaim.catalog.building import find_datetime
    from geoaim.tracks.dates import EPOCH, read_start

    for path in paths:
        if start := read_start(path):
            return str(start), str(path)
        if video := find_video(find_in_folder(path, TRACKS_FILE)):
            return find_datetime(None, str(video), video)
    return EPOCH, "not known: give --start-date"


def _change_times(
    tracks: "Tracks", rate: float | None, start: float | None, duration: float | None
) -> "Tracks":
    from geoaim.tracks.changes import cut_tracks, resample_tracks

    if start is not None or duration is not None:
        start = float(tracks.times[0]) if start is None else start
        rest = float(tracks.times[-1]) - start
        tracks = cut_tracks(tracks, start, rest if duration is None else duration)
    return tracks if rate is None else resample_tracks(tracks, rate)


def _warn_of_derived_states(tracks: "Tracks", paths: list[Path]) -> None:
    """Warn where written states know of later rows: the format has no column for observed ones."""
    import numpy as np

    if not np.array_equal(tracks.states, tracks.get_observed(), equal_nan=True):
        warn(
            f"headings and speeds, or positions between rows, are computed from all of "
            f"{', '.join(map(str, paths))}: a "
            "prediction from the written file knows up to half a second of what comes; predict "
            "from the original"
        )
