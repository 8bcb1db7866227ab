"""Commands that make maps and look at them."""

import glob
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import typer
from rich.table import Table
from rich.text import Text

from geoaim.cli.console import (
    AimFile,
    TracksPixel,
    TracksWorld,
    console,
    plain_errors,
    read_any_tracks,
    refuse_output,
    stages,
)

if TYPE_CHECKING:
    from geoaim.aim import AIM
    from geoaim.mapping.georeference.georeference import Georeference

Source = Annotated[str, typer.Argument(help="a video file, or a folder or glob of images")]
Points = Annotated[
    Path | None,
    typer.Option(help="control points: CSV, OpenDroneMap gcp_list.txt, QGIS .points"),
]
GEOTIFF = (".tif", ".tiff")
DetectionsFolder = Annotated[
    Path | None, typer.Option(help="folder of YOLO .txt files, one a frame")
]


def build(
    video: Source,
    output: Annotated[Path, typer.Option("--output", "-o", help="GeoTIFF to write")],
    gcps: Points = None,
    detections: DetectionsFolder = None,
    frames: Annotated[str, typer.Option(help="auto, all, or how many")] = "auto",
    crs: Annotated[str | None, typer.Option(help="of the map, e.g. EPSG:32635")] = None,
    resolution: Annotated[
        float | None,
        typer.Option(help="metres a pixel, north up; as filmed if left out"),
    ] = None,
    frame_resolution: Annotated[
        float | None,
        typer.Option(help="m per pixel of the video, for a local map without control points"),
    ] = None,
) -> None:
    """Build a georeferenced AIM from a hovering drone's video, and a quick look beside it.

    Control points are picked on the first frame unless their file says on which. Without them the
    telemetry beside the video gives an approximate place, or --frame-resolution a local one.
    """
    from geoaim.aim_files import write_aim
    from geoaim.mapping.georeference.from_telemetry import make_local_georeference
    from geoaim.mapping.pipeline import build_aim
    from geoaim.mapping.video.video import open_video
    from geoaim.quicklook import write_quicklook
    from geoaim.rectification import rectify

    with stages() as progress, plain_errors():
        if frame_resolution is not None and gcps is not None:
            raise ValueError("--gcps and --frame-resolution both say where the map lies; give one")
        look = _look_beside(output, [gcps, *_named(video, f"{glob.escape(output.stem)}.*")])
        opened = open_video(video)
        size = opened.height, opened.width
        place: Path | Georeference | None = gcps
        if frame_resolution is not None:
            place = make_local_georeference(resolution=frame_resolution, size=size)
        aim = build_aim(
            opened,
            place,
            detections=detections,
            frames=_count(frames),
            crs=crs,
            progress=progress,
        )
        progress("write", 0, 2)
        if resolution is not None or not aim.is_affine:
            aim = rectify(aim, resolution)
        write_aim(aim, output)
        progress("write", 1, 2)
        write_quicklook(aim, look)
        progress("write", 2, 2)
    _show(aim, f"{output} and {look}")


def align(
    tiles: Annotated[
        list[str],
        typer.Argument(help="orthophotos, folders of tiles, MBTiles, addresses of tile services"),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="GeoTIFF to write")],
    tracks: Annotated[Path | None, typer.Option(help="of vehicles, in any known form")] = None,
    tracks_world: TracksWorld = None,
    tracks_resolution: TracksPixel = None,
    aim: Annotated[Path | None, typer.Option(help="AIM of the same place")] = None,
    gcps: Points = None,
    resolution: Annotated[float | None, typer.Option(help="metres a pixel")] = None,
    crs: Annotated[
        str | None, typer.Option(help="of imagery or control points that name none")
    ] = None,
    reach: Annotated[float, typer.Option(help="m by which imagery may be off", min=1)] = 15.0,
    turn: Annotated[float, typer.Option(help="degrees by which it may be", min=0, max=45)] = 5.0,
    zoom: Annotated[float, typer.Option(help="percent of its size by which", min=0, max=30)] = 5.0,
) -> None:
    """Lay imagery of others where it belongs: by control points, an AIM, or tracks alone.

    The first of these that is given places it, the others check. A quick look beside the map shows
    it before and after. Without any of them the imagery stays where it says to lie.
    """
    from geoaim.aim_files import read_aim, write_aim
    from geoaim.alignment_picture import draw_alignment
    from geoaim.files import write_figure
    from geoaim.imagery.alignment.pipeline import align_tiles
    from geoaim.imagery.alignment.result import Prior
    from geoaim.rectification import rectify
    from geoaim.track_changes import to_world

    with plain_errors():
        beside = f"**/{glob.escape(output.stem)}.*"
        read = [path for source in tiles for path in _named(source, beside)]
        look = _look_beside(output, [aim, tracks, gcps, *read])
        place = None if aim is None else read_aim(aim)
        way = None
        if tracks is not None:
            way = read_any_tracks(tracks, tracks_world, tracks_resolution)
        found = align_tiles(
            tiles[0] if len(tiles) == 1 else tiles,
            tracks=way,
            aim=place,
            gcps=gcps,
            resolution=resolution,
            crs=crs,
            prior=Prior(reach, float(np.radians(turn)), zoom / 100),
        )
        write_aim(found if found.is_affine else rectify(found), output)
        if way is not None:
            way = to_world(way, found.world)
        write_figure(draw_alignment(found, aim=place, tracks=way), look)
    _show(found, f"{output} and {look}")


def register(
    video: Source,
    output: Annotated[Path, typer.Option("--output", "-o", help=".csv or .parquet to write")],
    detections: DetectionsFolder = None,
    reference: Annotated[
        float | None, typer.Option(help="seconds of the reference; chosen by the data if left out")
    ] = None,
) -> None:
    """Lay every frame of a video on one reference frame: a table of matrices, a row a frame.

    m00 to m22 map a frame's pixels to the reference's. With --reference 0 these are the pixels of
    a map built with control points on the first frame.
    """
    from geoaim.mapping.registration.register import count_reasons, write_registration
    from geoaim.mapping.registration.register import register as register_frames

    with stages() as progress, plain_errors():
        refuse_output(output, (".csv", ".parquet"))
        result = register_frames(
            video, detections=detections, reference_time=reference, progress=progress
        )
        write_registration(result, output)
    table = Table(title=Text(str(output)), show_header=False)
    table.add_row("motion model", result.reference.model)
    table.add_row("reference", f"frame {result.reference.index}, {result.reference.time:.2f} s")
    table.add_row("frames laid", f"{result.valid.sum()} of {len(result.valid)}")
    for reason, count in count_reasons(result.reason).items():
        table.add_row("refused", f"{count}: {reason}")
    console.print(table)


def texture(
    aim: AimFile,
    folder: Annotated[Path, typer.Argument(help="where texture.png and texture.json go")],
    resolution: Annotated[float | None, typer.Option(help="metres a pixel")] = None,
) -> None:
    """Export an AIM as a texture and its corner frame, for a renderer."""
    from geoaim.aim_files import read_aim
    from geoaim.mapping.texture import export_texture

    with plain_errors():
        export_texture(read_aim(aim), folder, resolution=resolution)
    console.print(f"{folder / 'texture.png'}, {folder / 'texture.json'}")


def draw(
    hdmap: Annotated[Path, typer.Argument(help="a lanelet2 map, .osm")],
    output: Annotated[Path, typer.Option("--output", "-o", help=".tif to write")],
    resolution: Annotated[float, typer.Option(help="metres a pixel", min=0.001)] = 0.2,
    aim: Annotated[Path | None, typer.Option(help="AIM in whose world to draw it")] = None,
) -> None:
    """Draw an HD map as an AIM, so that every command and model reads it as one.

    A map of metres about (0, 0), as INTERACTION's and SinD's, needs no --aim.
    """
    from geoaim.aim_files import read_aim, write_aim
    from geoaim.hdmap.lanelet2 import read_hdmap
    from geoaim.hdmap.rasterize import draw_hdmap

    with plain_errors():
        refuse_output(output, GEOTIFF, [hdmap, aim])
        world = None if aim is None else read_aim(aim).world
        drawn = draw_hdmap(read_hdmap(hdmap, world), resolution=resolution)
        write_aim(drawn, output)
    height, width = drawn.image.shape[:2]
    console.print(f"{output}: {height} x {width} px of {resolution} m")


def info(aim: AimFile) -> None:
    """Say what an AIM is, where it lies and how far to trust it."""
    from geoaim.aim_files import read_aim

    with plain_errors():
        found = read_aim(aim)
    _show(found, str(aim))


def _named(source: str, inside: str) -> list[Path]:
    """The files that a source names: itself, what matches it, or of a folder some inside."""
    path = Path(source)
    if path.is_dir():
        return list(path.glob(inside))
    return [path, *map(Path, glob.glob(source, recursive=True))]


def _look_beside(output: Path, inputs: Sequence[Path | None]) -> Path:
    """The quick look beside a map, once neither would replace what is read."""
    refuse_output(output, GEOTIFF, inputs)
    look = output.with_suffix(".png")
    if look.resolve() in [path.resolve() for path in inputs if path is not None]:
        raise ValueError(
            f"the quick look beside {output} would replace {look}, which is read; give another "
            "name to write"
        )
    refuse_output(look)
    return look


def _count(text: str) -> int | Literal["auto", "all"]:
    if text == "auto":
        return "auto"
    if text == "all":
        return "all"
    if not text.isdigit() or int(text) < 1:
        raise typer.BadParameter(f"{text!r} is not auto, all or a number", param_hint="--frames")
    return int(text)


def _show(aim: "AIM", title: str) -> None:
    from geoaim.aim_summary import summarize_aim

    table = Table(title=Text(title), show_header=False)
    for name, value in summarize_aim(aim).items():
        table.add_row(name, value)
    console.print(table)
