"""Build a map from video, or from one image."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from geoaim.cli import options
from geoaim.cli.console import print_result, report_errors, show_progress
from geoaim.cli.outputs import check_map_output

if TYPE_CHECKING:
    from geoaim.mapping.sampling import FrameCount


def build(
    video: options.VideoSource,
    output: Annotated[Path, options.output("GeoTIFF to write")],
    gcps: options.ControlPoints = None,
    detections: options.DetectionsFolder = None,
    frames: Annotated[
        str, typer.Option(help="frames used for the background: auto, all or a number")
    ] = "auto",
    crs: Annotated[str | None, typer.Option(help="CRS of the map, such as EPSG:32635")] = None,
    resolution: Annotated[
        float | None,
        options.resolution(
            "metres per pixel of the map; as in the video if omitted. Of a single image without "
            "control points: metres per pixel of the image"
        ),
    ] = None,
    frame_resolution: Annotated[
        float | None,
        typer.Option(help="metres per pixel of the video, for a map without control points"),
    ] = None,
    frame_origin: Annotated[
        Literal["corner", "middle"],
        typer.Option(help="origin of a map without control points: top-left corner of the frame"),
    ] = "corner",
    height: Annotated[
        float | None,
        typer.Option(help="camera's height above the ground, m, if telemetry lacks it"),
    ] = None,
    yaw: Annotated[
        float | None,
        typer.Option(help="compass heading of the image's top, degrees, if telemetry lacks it"),
    ] = None,
    focal_length: Annotated[
        float | None,
        typer.Option(
            help="focal length, 35 mm equivalent with any zoom, mm, if telemetry lacks it"
        ),
    ] = None,
    fixed_camera: options.FixedCamera = False,
    as_json: options.AsJson = False,
) -> None:
    """Build a georeferenced map (AIM) from a hovering drone's video, or from one image.

    Control points are pixels of the first frame, unless their file names another. Without control
    points the telemetry beside the video gives an approximate position, or --frame-resolution a
    map in local coordinates. A single image becomes a map as it is, by its control points or
    --resolution. A quick-look .png is written beside the map.

    Example: geoaim build samples/hover.mp4 --gcps samples/gcps.csv -o map.tif
    """
    from geoaim.mapping.build_map import MapSettings, build_map

    with show_progress() as progress, report_errors():
        look = check_map_output(output, [video], [gcps])
        aim = build_map(
            video,
            output,
            gcps=gcps,
            detections=detections,
            settings=MapSettings(
                frames=_parse_frames(frames),
                crs=crs,
                resolution=resolution,
                frame_resolution=frame_resolution,
                frame_origin=frame_origin,
                height=height,
                yaw=yaw,
                focal_length=focal_length,
                fixed_camera=fixed_camera,
            ),
            progress=progress,
        )
    print_result([output, look], aim.summarize(), as_json, report=aim.report)


def _parse_frames(text: str) -> "FrameCount":
    from geoaim.mapping.sampling import parse_frame_count

    try:
        return parse_frame_count(text)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--frames") from None
