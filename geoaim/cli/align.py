"""The command that aligns third-party imagery."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from geoaim.base.defaults import MAX_ROTATION_DEGREES, MAX_SCALING, MAX_SHIFT
from geoaim.cli import options
from geoaim.cli.console import print_result, report_errors
from geoaim.cli.inputs import read_any_aim, read_any_tracks
from geoaim.cli.outputs import check_map_output

if TYPE_CHECKING:
    from geoaim.imagery.alignment.pipeline import Shift


def align(
    imagery: Annotated[
        list[str],
        typer.Argument(help="orthophotos, folders of tiles, .mbtiles, or URLs of tile services"),
    ],
    output: Annotated[Path, options.output("GeoTIFF to write")],
    tracks: options.OptionalTracks = None,
    tracks_world: options.TracksWorld = None,
    tracks_resolution: options.TracksResolution = None,
    tracks_frame_rate: options.TracksFrameRate = None,
    aim: Annotated[Path | None, typer.Option(help="AIM or orthophoto of the same place")] = None,
    points: options.ControlPoints = None,
    shift: Annotated[
        str | None,
        typer.Option(help="move it by hand first: metres east,north[,degrees counter-clockwise]"),
    ] = None,
    resolution: Annotated[float | None, options.resolution()] = None,
    crs: Annotated[
        str | None, typer.Option(help="CRS of imagery or control points that state none")
    ] = None,
    zoom: Annotated[
        int | None,
        typer.Option(help="zoom level of tiles; by --resolution if omitted", min=0, max=30),
    ] = None,
    tms: Annotated[
        bool, typer.Option("--tms", help="y of tiles counts from the south (Tile Map Service)")
    ] = False,
    tile_size: Annotated[
        int, typer.Option(help="side of a tile service's tiles, pixels", min=1)
    ] = 256,
    nodata: Annotated[
        str | None,
        typer.Option(
            help="value that shows nothing, in imagery that states none; 'none' keeps plain white "
            "or black at the edge"
        ),
    ] = None,
    output_crs: Annotated[
        str | None, typer.Option(help="CRS of the map, projected and in metres")
    ] = None,
    keep_extent: Annotated[
        bool, typer.Option(help="keep all of the imagery, also far from the AIM or the tracks")
    ] = False,
    model: Annotated[
        Literal["auto", "similarity"],
        typer.Option(
            help="with --points: 'similarity' for a picture that is an orthophoto, free of tilt"
        ),
    ] = "auto",
    max_shift: Annotated[float, typer.Option(help="largest expected shift, m", min=1)] = MAX_SHIFT,
    max_rotation: Annotated[
        float, typer.Option(help="largest expected rotation, degrees", min=0, max=45)
    ] = MAX_ROTATION_DEGREES,
    max_scaling: Annotated[
        float, typer.Option(help="largest expected change of scale, percent", min=0, max=30)
    ] = 100 * MAX_SCALING,
    as_json: options.AsJson = False,
) -> None:
    """Correct the position of orthophotos or map tiles, and write them as an AIM.

    The position comes from control points, else from an AIM of the same place, else from tracks
    of vehicles; further ones that are given check that position. Without any of them the imagery
    is not aligned: it stays at its stated position, or where --shift moves it. A .png beside the
    output shows the imagery before and after.

    Example: geoaim align samples/ortho.tif --tracks samples/tracks.csv -o ortho.tif
    """
    from geoaim.aim.files import write_aim
    from geoaim.base.files import atomic_files, write_figure
    from geoaim.imagery.alignment.before_after import draw_alignment
    from geoaim.imagery.alignment.pipeline import align_tiles
    from geoaim.imagery.alignment.result import Prior
    from geoaim.imagery.tiles import Tiles
    from geoaim.tracks.changes import to_world

    with report_errors():
        look = check_map_output(output, imagery, [aim, tracks, points], recursive=True)
        is_plain = zoom is None and not tms and tile_size == Tiles.tile_size
        sources = imagery if is_plain else [Tiles(x, zoom, tms, tile_size) for x in imagery]
        reference = None if aim is None else read_any_aim(aim, sources, crs, 1.5 * max_shift)
        agents = None
        if tracks is not None:
            agents = read_any_tracks(tracks, tracks_world, tracks_resolution, tracks_frame_rate)
        aligned = align_tiles(
            sources[0] if len(sources) == 1 else sources,
            tracks=agents,
            aim=reference,
            gcps=points,
            resolution=resolution,
            crs=crs,
            prior=Prior(max_shift, math.radians(max_rotation), max_scaling / 100),
            shift=None if shift is None else _parse_shift(shift),
            nodata=_parse_nodata(nodata),
            similarity=model == "similarity",
            output_crs=output_crs,
            keep_extent=keep_extent,
        )
        if agents is not None:
            agents = to_world(agents, aligned.world)
        with atomic_files(output, look) as (map_part, look_part):
            write_aim(aligned, map_part)
            write_figure(draw_alignment(aligned, aim=reference, tracks=agents), look_part)
    print_result([output, look], aligned.summarize(), as_json, report=aligned.report)


def _parse_shift(text: str) -> "Shift":
    from geoaim.imagery.alignment.pipeline import Shift

    try:
        east, north, *turn = (float(word) for word in text.split(","))
        [degrees] = turn or [0.0]
    except ValueError as error:
        raise ValueError(f"--shift {text!r} is not metres E,N or E,N,degrees: 2.5,-1") from error
    return Shift(east, north, math.radians(degrees))


def _parse_nodata(text: str | None) -> float | Literal["none"] | None:
    if text is None:
        return None
    if text == "none":
        return "none"
    try:
        return float(text)
    except ValueError as error:
        raise ValueError(f"--nodata {text!r} is neither a number nor 'none'") from error
