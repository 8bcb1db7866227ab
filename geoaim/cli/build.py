"""Build a map from video."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from geoaim.cli import options
from geoaim.cli.console import print_result, report_errors, show_progress
from geoaim.cli.outputs import check_map_output

if TYPE_CHECKING:
    from geoaim.mapping.georeference.georeference import Georeference


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
        float | None, options.resolution("metres per pixel of the map; as in the video if omitted")
    ] = None,
    frame_resolution: Annotated[
        float | None,
        typer.Option(help="metres per pixel of the video, for a map without control points"),
    ] = None,
    height: Annotated[
        float | None,
        typer.Option(help="camera's height above the ground, m, if telemetry lacks it"),
    ] = None,
    yaw: Annotated[
        float | None,
        typer.Option(help="compass heading of the image's top, degrees, if telemetry lacks it"),
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Build a georeferenced map (AIM) from a hovering drone's video.

    Control points are pixels of the first frame, unless their file names another. Without control
    points the telemetry beside the video gives an approximate position, or --frame-resolution a
    map in local coordinates. A quick-look .png is written beside the map.

    Example: geoaim build samples/hover.mp4 --gcps samples/gcps.csv -o map.tif
    """
    from geoaim.aim_files import write_aim
    from geoaim.files import atomic_files, write_figure
    from geoaim.mapping.georeference.from_telemetry import make_local_georeference
    from geoaim.mapping.georeference.reference_frame import override_telemetry
    from geoaim.mapping.pipeline import build_aim
    from geoaim.mapping.video.video import open_video
    from geoaim.quicklook import draw_quicklook
    from geoaim.rectification import rectify

    with show_progress() as progress, report_errors():
        if frame_resolution is not None and gcps is not None:
            raise ValueError("--gcps and --frame-resolution exclude each other; give one")
        if (height, yaw) != (None, None) and (gcps, frame_resolution) != (None, None):
            raise ValueError(
                "--height and --yaw complete telemetry, which --gcps and --frame-resolution "
                "replace; give one or the other"
            )
        look = check_map_output(output, [video], [gcps])
        opened = override_telemetry(open_video(video), height=height, yaw=yaw)
        georeference: Path | Georeference | None = gcps
        if frame_resolution is not None:
            size = opened.height, opened.width
            georeference = make_local_georeference(resolution=frame_resolution, size=size)
        aim = build_aim(
            opened,
            georeference,
            detections=detections,
            frames=_parse_frames(frames),
            crs=crs,
            progress=progress,
        )
        progress("write", 0, 1)
        if resolution is not None or not aim.is_affine:
            aim = rectify(aim, resolution)
        with atomic_files(output, look) as (map_part, look_part):
            write_aim(aim, map_part)
            write_figure(draw_quicklook(aim), look_part)
        progress("write", 1, 1)
    print_result([output, look], aim.summarize(), as_json, report=aim.report)


def _parse_frames(text: str) -> int | Literal["auto", "all"]:
    if text == "auto":
        return "auto"
    if text == "all":
        return "all"
    if not text.isdecimal() or int(text) < 1:
        raise typer.BadParameter(f"{text!r} is not auto, all or a number", param_hint="--frames")
    return int(text)
