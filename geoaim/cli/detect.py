"""The command that detects vehicles in a video or in pictures."""

from pathlib import Path
from typing import Annotated

import typer

from geoaim.cli import options
from geoaim.cli.console import print_result, report_errors, show_progress


def detect(
    video: options.VideoSources,
    output: Annotated[
        Path, options.output(".csv to write, or new folder for YOLO's oriented boxes (.txt)")
    ],
    frame_resolution: Annotated[
        float | None,
        typer.Option(help="metres per pixel of the frames; proposed by their vehicles if omitted"),
    ] = None,
    min_probability: Annotated[
        float, typer.Option(help="boxes that are less probable are left out", min=0.01, max=0.99)
    ] = 0.5,
    as_json: options.AsJson = False,
) -> None:
    """Detect the vehicles in each frame of a video, or in pictures, from above.

    A small network comes with geoaim: it needs no GPU and no download. Each box is oriented and has
    the probability that it is right. What stands is found as well as what moves. The boxes are what
    track, build and place take as --detections, and YOLO's tools read the folder.

    Example: geoaim detect samples/hover.mp4 -o boxes.csv
    """
    from geoaim.base.files import check_new_folder
    from geoaim.cli.outputs import check_output
    from geoaim.detection.detect import detect as detect_in_video
    from geoaim.detection.detect import summarize, write_detections

    with show_progress() as progress, report_errors():
        if output.suffix.lower() == ".csv":
            check_output(output)
        elif output.suffix:
            raise ValueError(f"{output}: give a name that ends in .csv, or a new folder")
        else:
            check_new_folder(output)
        found = detect_in_video(
            video, resolution=frame_resolution, min_probability=min_probability, progress=progress
        )
        write_detections(found, output)
    print_result([output], summarize(found), as_json)
