"""Build a map from video, or from one image."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from geoaim.cli import options
from geoaim.cli.console import print_result, report_errors, show_progress
from geoaim.cli.outputs import check_map_output

if TYPE_CHECKING:
    from collections.abc import Callable

    from geoaim.aim.aim import AIM
    from geoaim.base.progress import Progress
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
    imagery: Annotated[
        list[str] | None,
        typer.Option(
            help="orthophoto or tiles of the place, which place the map instead of points"
        ),
    ] = None,
    near: Annotated[
        str | None,
        typer.Option(
            help="latitude,longitude of the frame's middle to 35 m, if telemetry lacks it"
        ),
    ] = None,
    imagery_accuracy: Annotated[
        float,
        typer.Option(
            help="standard deviation of the imagery's place, m; 0 takes it as right", min=0.0
        ),
    ] = 0.0,
    as_json: options.AsJson = False,
) -> None:
    """Build a georeferenced map (AIM) from a hovering drone's video, or from one image.

    Control points are pixels of the first frame, unless their file names another. Without control
    points the telemetry beside the video gives an approximate position, or --frame-resolution a
    map in local coordinates. A single image becomes a map as it is, by its control points or
    --resolution. --imagery places the map by an orthophoto or tiles of any day, starting from the
    telemetry or from --near with about the right --frame-resolution. A quick-look .png is written
    beside the map.

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
            place=_choose_placing(imagery, near, imagery_accuracy, gcps, progress),
            progress=progress,
        )
    print_result([output, look], aim.summarize(), as_json, report=aim.report)


def _choose_placing(
    imagery: list[str] | None,
    near: str | None,
    accuracy: float,
    gcps: Path | None,
    progress: "Progress",
) -> "Callable[[AIM], AIM] | None":
    """What places the map by imagery, if that is asked for."""
    if not imagery:
        if near is not None or accuracy:
            raise ValueError("--near and --imagery-accuracy need --imagery, which places the map")
        return None
    if gcps is not None:
        raise ValueError("--gcps and --imagery both place the map; give one")
    sources, start = list(imagery), None if near is None else _parse_near(near)

    def place(aim: "AIM") -> "AIM":
        from geoaim.imagery.alignment.placing import place_by_imagery

        return place_by_imagery(aim, sources, near=start, accuracy=accuracy, progress=progress)

    return place


def _parse_near(text: str) -> tuple[float, float]:
    try:
        latitude, longitude = map(float, text.split(","))
    except ValueError:
        raise ValueError(
            f"--near {text!r} is not latitude,longitude in degrees, such as 49.99,36.23"
        ) from None
    if not (abs(latitude) <= 90 and abs(longitude) <= 180):
        raise ValueError(f"--near {text!r}: a latitude is at most 90, a longitude at most 180")
    return latitude, longitude


def _parse_frames(text: str) -> "FrameCount":
    from geoaim.mapping.sampling import parse_frame_count

    try:
        return parse_frame_count(text)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--frames") from None
