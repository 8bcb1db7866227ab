"""The command that tracks the agents of a video."""

from pathlib import Path
from typing import Annotated

import typer

from geoaim.cli import options
from geoaim.cli.console import print_result, report_errors, show_progress
from geoaim.cli.outputs import TRACKS, check_output


def track(
    video: options.VideoSource,
    aim: Annotated[Path, typer.Option(help="AIM of the same ground, best one of this video")],
    output: Annotated[Path, options.output(".csv or .parquet to write")],
    detections: Annotated[
        Path, typer.Option(help="boxes of a detector: a folder of YOLO .txt, MOT, COCO .json, .csv")
    ],
    columns: Annotated[
        str | None,
        typer.Option(help="columns of a .csv, such as frame=frame,id=track,x=u_px,y=v_px"),
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
    image_rate: Annotated[
        float | None, typer.Option(help="images per second of a folder of images", min=0.01)
    ] = None,
    hdmap: options.HDMapFile = None,
    as_json: options.AsJson = False,
) -> None:
    """Track the agents of a video on its map, from the boxes of a detector.

    The frames are registered to the map, which takes the boxes to metres on the ground. Tracks
    bridge misses of up to ten seconds, and longer ones of what stands, and are smoothed; the states
    that were known at each time are in columns of their own.

    Example: geoaim track samples/hover.mp4 --aim map.tif --detections samples/boxes -o tracks.csv
    """
    from geoaim.aim.files import read_aim
    from geoaim.hdmap.lanelet2 import read_hdmap
    from geoaim.mapping.video.detection_checks import parse_size
    from geoaim.mapping.video.detection_columns import parse_columns
    from geoaim.mapping.video.detections import read_detections
    from geoaim.mapping.video.video import open_video
    from geoaim.tracking.pipeline import track_video
    from geoaim.tracking.report import summarize_tracking
    from geoaim.tracks.files import write_tracks

    with show_progress() as progress, report_errors():
        check_output(output, TRACKS, [aim, hdmap])
        names = tuple(name.strip() for name in classes.split(",") if name.strip())
        chosen = None if columns is None else parse_columns(columns)
        opened = open_video(video, rate=image_rate or 1.0)
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
        ground = read_aim(aim)
        lanes = None if hdmap is None else read_hdmap(hdmap, ground.world)
        tracks = track_video(opened, ground, boxes, hdmap=lanes, progress=progress)
        write_tracks(tracks, output)
    print_result([output], summarize_tracking(tracks, ground), as_json)
