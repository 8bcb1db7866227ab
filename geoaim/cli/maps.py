"""Commands that make maps and prepare them: build, draw, texture, frame, register."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from geoaim.cli import options
from geoaim.cli.console import console, print_result, report_errors, show_progress
from geoaim.cli.outputs import GEOTIFF, TRACKS, check_map_output, check_output

if TYPE_CHECKING:
    from collections.abc import Callable

    from geoaim.aim.aim import AIM
    from geoaim.base.progress import Progress
    from geoaim.mapping.sampling import FrameCount


def build(
    video: options.VideoSources,
    output: Annotated[Path, options.output("GeoTIFF to write")],
    points: options.ControlPoints = None,
    detections: options.DetectionsFolder = None,
    frames: Annotated[
        str, typer.Option(help="frames used for the background: auto, all or a number")
    ] = "auto",
    output_crs: Annotated[
        str | None, typer.Option(help="CRS of the map, such as EPSG:32635")
    ] = None,
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
    flying_height: Annotated[
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
    near: options.Near = None,
    imagery_accuracy: options.ImageryAccuracy = None,
    as_json: options.AsJson = False,
) -> None:
    """Build a georeferenced map (AIM) from a hovering drone's video, or from one image.

    Control points are pixels of the first frame, unless their file names another. Without control
    points the telemetry beside the video gives an approximate position, or --frame-resolution a
    map in local coordinates. A single image becomes a map as it is, by its control points or
    --resolution. --imagery places the map by an orthophoto or tiles of any day, starting from the
    telemetry or from --near with about the right --frame-resolution. A quick-look .png is written
    beside the map.

    Example: geoaim build samples/hover.mp4 --points samples/gcps.csv -o map.tif
    """
    from geoaim.mapping.build_map import MapSettings, build_map

    with show_progress() as progress, report_errors():
        look = check_map_output(output, video, [points])
        aim = build_map(
            video,
            output,
            gcps=points,
            detections=detections,
            settings=MapSettings(
                frames=_parse_frames(frames),
                crs=output_crs,
                resolution=resolution,
                frame_resolution=frame_resolution,
                frame_origin=frame_origin,
                height=flying_height,
                yaw=yaw,
                focal_length=focal_length,
                fixed_camera=fixed_camera,
            ),
            place=_choose_placing(imagery, near, imagery_accuracy, points, progress),
            progress=progress,
        )
    print_result([output, look], aim.summarize(), as_json, report=aim.report)


def _choose_placing(
    imagery: list[str] | None,
    near: str | None,
    accuracy: float | None,
    points: Path | None,
    progress: "Progress",
) -> "Callable[[AIM], AIM] | None":
    """What places the map by imagery, if that is asked for."""
    if not imagery:
        if near is not None or accuracy is not None:
            raise ValueError("--near and --imagery-accuracy need --imagery, which places the map")
        return None
    if points is not None:
        raise ValueError("--points and --imagery both place the map; give one")
    from geoaim.imagery.alignment.place_by_imagery import parse_near, place_by_imagery

    sources, start = list(imagery), None if near is None else parse_near(near)

    def place(aim: "AIM") -> "AIM":
        return place_by_imagery(aim, sources, near=start, accuracy=accuracy, progress=progress)

    return place


def _parse_frames(text: str) -> "FrameCount":
    from geoaim.mapping.sampling import parse_frame_count

    try:
        return parse_frame_count(text)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--frames") from None


def draw(
    hdmap: Annotated[Path, typer.Argument(help="lanelet2 map, .osm")],
    output: Annotated[Path, options.output("GeoTIFF to write")],
    resolution: Annotated[float, options.resolution()] = 0.2,
    aim: Annotated[Path | None, typer.Option(help="AIM whose world is used")] = None,
) -> None:
    """Draw an HD map as an AIM, for use with every command and model.

    Maps in metres around (0, 0), such as those of INTERACTION and SinD, need no --aim.

    Example: geoaim draw samples/map.osm -o map.tif
    """
    from geoaim.aim.files import read_aim, write_aim
    from geoaim.hdmap.lanelet2 import read_hdmap
    from geoaim.hdmap.rasterize import draw_hdmap

    with report_errors():
        check_output(output, GEOTIFF, [hdmap, aim])
        world = None if aim is None else read_aim(aim).world
        drawn = draw_hdmap(read_hdmap(hdmap, world), resolution=resolution)
        write_aim(drawn, output)
    height, width = drawn.image.shape[:2]
    console.print(f"{output}: {width} x {height} px, {resolution} m per pixel")


def texture(
    aim: options.AimFile,
    folder: Annotated[Path, typer.Argument(help="folder for texture.png and texture.json")],
    resolution: Annotated[float | None, options.resolution()] = None,
) -> None:
    """Export an AIM as a texture and its corner frame, for a renderer.

    Example: geoaim texture map.tif texture
    """
    from geoaim.aim.texture_files import read_map
    from geoaim.mapping.texture import export_texture

    with report_errors():
        check_output(folder / "texture.json", inputs=[aim])
        export_texture(read_map(aim), folder, resolution=resolution)
    console.print(f"{folder / 'texture.png'}, {folder / 'texture.json'}")


def frame(
    video: options.VideoSource,
    output: Annotated[Path, options.output(".png to write")],
    time: Annotated[float, typer.Option(help="time of the frame, s", min=0)] = 0.0,
) -> None:
    """Save a frame of a video as a .png, to pick control points on it.

    Example: geoaim frame samples/hover.mp4 -o frame.png
    """
    from PIL import Image

    from geoaim.base.files import atomic_write
    from geoaim.mapping.video.video import open_video, read_frame

    with report_errors():
        check_output(output, (".png",), [Path(video)])
        found = read_frame(open_video(video), time)
        with atomic_write(output) as temporary:
            Image.fromarray(found.image).save(temporary, format="png")
    height, width = found.image.shape[:2]
    console.print(f"{output}: frame {found.index} at {found.time:.2f} s, {width} x {height} px")


def register(
    video: options.VideoSources,
    output: Annotated[Path, options.output(".csv or .parquet to write")],
    detections: options.DetectionsFolder = None,
    reference_time: Annotated[
        float | None,
        typer.Option(help="time of the reference frame, s; chosen automatically if omitted"),
    ] = None,
    fixed_camera: options.FixedCamera = False,
    as_json: options.AsJson = False,
) -> None:
    """Register the frames of a video to a reference frame.

    The table has a row for each frame; its matrix m00 to m22 maps pixels of the frame to pixels
    of the reference. With --reference-time 0 the reference is the first frame, in which control
    points are usually picked.

    Example: geoaim register samples/hover.mp4 -o registration.csv
    """
    from geoaim.mapping.registration.register import count_reasons, write_registration
    from geoaim.mapping.registration.register import register as register_frames

    with show_progress() as progress, report_errors():
        check_output(output, TRACKS)
        result = register_frames(
            video,
            detections=detections,
            model="rest" if fixed_camera else None,
            reference_time=reference_time,
            progress=progress,
        )
        write_registration(result, output)
    lines = {
        "motion model": result.reference.model,
        "reference": f"frame {result.reference.index}, {result.reference.time:.2f} s",
        "registered frames": f"{result.valid.sum()} of {len(result.valid)}",
    }
    for reason, count in count_reasons(result.reason).items():
        lines[f"rejected: {reason}"] = str(count)
    print_result([output], lines, as_json)
