"""The command that takes a video all the way: map, tracks, film and report in one folder."""

from pathlib import Path
from typing import Annotated

import typer

from geoaim.cli import options
from geoaim.cli.console import console, print_result, report_errors, show_progress


def place(
    video: options.VideoSources,
    output: Annotated[Path, options.output("new folder for the map, the tracks and the report")],
    imagery: Annotated[
        list[str] | None, typer.Option(help="orthophoto or tiles of the place, which place the map")
    ] = None,
    near: options.Near = None,
    imagery_accuracy: options.ImageryAccuracy = None,
    points: options.ControlPoints = None,
    detections: options.DetectionsFolder = None,
    frame_resolution: Annotated[
        float | None,
        typer.Option(help="metres per pixel of the video; proposed by its cars if omitted"),
    ] = None,
    image_rate: options.ImageRate = None,
    lights: options.LightsFile = None,
    hdmap: options.HDMapFile = None,
    stop_lines: options.StopLinesFile = None,
    as_json: options.AsJson = False,
) -> None:
    """Take a video all the way: its map, its tracks, a film and a report, in one folder.

    Nothing else is needed: without imagery, points and telemetry the map has metres of its own, in
    which most vehicles are as large as cars; without boxes, geoaim's own network finds vehicles.
    The report says what is known, how surely, and what is missing. Other commands take the folder
    in place of a map and its tracks, with the lights and the HD map that were given.

    Example: geoaim place samples/hover.mp4 -o junction
    """
    from geoaim.base.files import check_new_folder

    with report_errors():
        check_new_folder(output)  # before the other imports, which take seconds
    from geoaim.imagery.alignment.place_by_imagery import parse_near
    from geoaim.mapping.video.video import open_video
    from geoaim.pipeline import Evidence, place_video

    with show_progress() as progress, report_errors():
        evidence = Evidence(
            points=points,
            imagery=list(imagery) if imagery else None,
            near=None if near is None else parse_near(near),
            imagery_accuracy=imagery_accuracy,
            detections=detections,
            frame_resolution=frame_resolution,
            lights=lights,
            hdmap=hdmap,
            stop_lines=stop_lines,
        )
        opened = open_video(video, rate=image_rate or 1.0)
        placed = place_video(opened, output, evidence, progress=progress)
    files = sorted(output.iterdir())
    lines = placed.known | {f"missing: {name}": text for name, text in placed.missing.items()}
    print_result([output] if not as_json else files, lines, as_json)
    if placed.tracks is None:
        raise typer.Exit(1)
    if not as_json:
        console.print(f"next: geoaim view {output}, geoaim predict {output} -o futures.png")
