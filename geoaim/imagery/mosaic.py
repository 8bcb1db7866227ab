"""Third-party imagery to an AIM: orthophotos, tiles and tile services, north up in a world.

aim = read_imagery("ortho.tif")
service = Tiles("https://host/{z}/{x}/{y}.png", zoom=19)
aim = read_imagery(["ortho.tif", service], world=aim.world, corners=aim.corners)
"""

import os
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.errors import GeoaimWarning, GeoreferenceError, ImageryError
from geoaim.geometry import transform_points, translation
from geoaim.grid import Grid, north_up_grid
from geoaim.imagery.rasters import (
    HALF_SEEN,
    Raster,
    Stretch,
    colours_of,
    find_stretch,
    place_raster,
    touches,
)
from geoaim.imagery.sources import Area, Layer, Source, Tiles, find_layer
from geoaim.world import LONLAT, World, choose_world, crs_from_world, transform_crs, world_from_crs

BLOCK = 1024  # px: side of the blocks that are drawn at a time
BENT = 0.005  # px by which a straight map from a block to a source's coordinates may err
COARSE = 3.0  # times the wanted resolution, from which a source is worth a warning
WIDEST = 6.0  # degrees of longitude or latitude that are taken as a whole


def read_imagery(
    sources: Source | Sequence[Source],
    *,
    world: World | None = None,
    corners: Float[Array, "n 2"] | None = None,
    resolution: float | None = None,
    crs: str | None = None,
    bands: Sequence[int] | None = None,
) -> AIM:
    """One image, north up, of imagery from any sources; the first lies on top.

    A source is a GeoTIFF, an image with a world file, a VRT, an MBTiles file, a folder or a
    pattern of such files, a folder of tiles (`z/x/y.png` or `NAME-x-y-z.png`), the address of a
    tile service (`https://host/{z}/{x}/{y}.png`), or anything else that GDAL opens; `Tiles` says
    more about tiles. Colours are resampled by cubic convolution, after means over what is finer
    than the grid. Nodata, masks and alpha leave holes; so do tiles that are missing or, of many
    files, cannot be read (with a warning). Values of more than 8 bits are stretched from their
    1st to 99th percentile there, jointly over the bands and rasters of a source. An alpha band is
    one that says so; other bands after the third are ignored.

    Args:
        sources: one or several.
        world: where to; when None, the UTM zone of the imagery.
        corners: points in world metres, whose bounds are covered; when None, all the imagery.
        resolution: metres a pixel; the finest source's own there, to four digits, when None.
        crs: of sources that name none, such as images with world files.
        bands: numbers of the band for grey or of those for red, green and blue, from 1; when
            None, by their colour interpretation, else the first three (or one of fewer).

    Returns:
        The image; coverage is 1 where imagery is. The report has, for each source, its CRS, its
        own resolution (m), bands, zoom, stretch, and the share of the image that shows it.

    Raises:
        FileNotFoundError: a source names no file.
        ImageryError: a source cannot be read or placed, or there is none of it in the area.
        AimError: the image would have more than 30,000 pixels a side.
        ValueError: no source, or a resolution, corners or bands that cannot be.
    """
    several = not isinstance(sources, str | os.PathLike | Tiles)
    asked: list[Source] = list(sources) if several else [sources]  # type: ignore[list-item, arg-type]
    _check_call(asked, world, corners, resolution, bands)
    area = None if corners is None or world is None else _area_of(world, corners)
    layers = [
        find_layer(source, area, resolution=resolution, crs=crs, bands=bands) for source in asked
    ]
    if area is None:
        world, corners = _whole_extent(layers, world)
        area = _area_of(world, corners)
    layers = _those_there(layers, area)
    sizes = [min(_pixel_size(raster, area) for raster in layer.rasters) for layer in layers]
    pixel = resolution or float(f"{min(sizes):.4g}")
    aim = _mosaic(layers, area, pixel, sizes)
    _warn_of_coarse(layers, sizes, pixel)
    return aim


def _check_call(
    asked: Sequence[Source],
    world: World | None,
    corners: Float[Array, "n 2"] | None,
    resolution: float | None,
    bands: Sequence[int] | None,
) -> None:
    if not asked:
        raise ValueError("no source of imagery was given: name at least one")
    if resolution is not None and not (np.isfinite(resolution) and resolution > 0):
        raise ValueError(f"resolution must be a positive number of metres, found {resolution}")
    if bands is not None and len(bands) not in (1, 3):
        raise ValueError(f"bands must be one for grey or three for RGB, found {list(bands)}")
    if world is None and corners is not None:
        raise ValueError("corners are metres of a world: give the world, or leave both out")
    if corners is not None and not (np.isfinite(corners).all() and np.ptp(corners, axis=0).all()):
        raise ValueError(f"corners must be finite and span an area, found {corners.tolist()}")
    if world is not None and world.crs is None:
        raise ImageryError(
            "the world has no CRS, so imagery has no place in it: georeference the world first "
            "(control points or telemetry), or leave it out to get one that suits the imagery"
        )


def _area_of(world: World, corners: Float[Array, "n 2"]) -> Area:
    low, high = corners.min(axis=0), corners.max(axis=0)
    shares = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)), axis=-1)
    return Area(world, low + (high - low) * shares.reshape(-1, 2))


def _whole_extent(
    layers: Sequence[Layer], world: World | None
) -> tuple[World, Float[Array, "n 2"]]:
    outlines = [outline for layer in layers for outline in layer.outlines]
    lonlat = np.concatenate([transform_crs(crs, LONLAT, points) for crs, points in outlines])
    spans = np.ptp(lonlat, axis=0)
    if spans.max() > WIDEST:
        raise ImageryError(
            f"the imagery spans {spans[0]:.3g} by {spans[1]:.3g} degrees (longitude, latitude), "
            f"and at most {WIDEST:g} are read as a whole: name a world and corners"
        )
    world = world or choose_world(lonlat)
    return world, np.concatenate([world_from_crs(world, points, crs) for crs, points in outlines])


def _those_there(layers: Sequence[Layer], area: Area) -> list[Layer]:
    """The layers that reach the area, with only those of their rasters that do."""
    there, elsewhere = [], []
    for layer in layers:
        points = {crs: _points_within(area, crs) for crs in {r.crs for r in layer.rasters}}
        rasters = tuple(r for r in layer.rasters if touches(r, points[r.crs]))
        if rasters:
            there.append(replace(layer, rasters=rasters))
        else:
            elsewhere.append(f"{layer.name} covers {_degrees(layer.outlines)}")
    needed = _degrees([(str(area.world.crs), area.points + area.world.origin)])
    message = f"{'; '.join(elsewhere)}; imagery is needed in {needed}"
    if not there:
        raise ImageryError(
            f"{message}: check the world, the corners (metres from its origin), and crs= or "
            "upside_down= of what says nothing itself"
        )
    if elsewhere:
        warnings.warn(message, GeoaimWarning, stacklevel=3)
    return there


def _points_within(area: Area, crs: str) -> Float[Array, "m 2"]:
    try:
        return area.within(crs)
    except GeoreferenceError:  # the far side of the Earth
        return np.full((1, 2), np.nan)


def _degrees(outlines: Sequence[tuple[str, Float[Array, "m 2"]]]) -> str:
    try:
        found = np.concatenate([transform_crs(crs, LONLAT, points) for crs, points in outlines])
    except GeoreferenceError as error:
        return f"a place that has no longitude and latitude ({error})"
    (west, south), (east, north) = found.min(axis=0), found.max(axis=0)
    return f"longitude {west:.6f} to {east:.6f}, latitude {south:.6f} to {north:.6f}"


def _pixel_size(raster: Raster, area: Area) -> float:
    """Side of a pixel amid the area, in metres: the root of its area."""
    middle = (area.points.min(axis=0) + area.points.max(axis=0)) / 2.0
    cross = middle + 5.0 * np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
    within = Area(area.world, cross).within(raster.crs)
    pixels = transform_points(raster.grid.grid_from_world, within)
    steps = (pixels[1::2] - pixels[::2]) / 10.0
    return float(1.0 / np.sqrt(abs(np.linalg.det(steps))))


def _warn_of_coarse(layers: Sequence[Layer], sizes: Sequence[float], resolution: float) -> None:
    for layer, size in zip(layers, sizes, strict=True):
        if size > COARSE * resolution:
            warnings.warn(
                f"{layer.name} has pixels of {size:.3g} m, and {resolution:.3g} m were wanted: "
                "the image is no sharper than they are",
                GeoaimWarning,
                stacklevel=3,
            )


def _mosaic(layers: Sequence[Layer], area: Area, resolution: float, sizes: Sequence[float]) -> AIM:
    grid = north_up_grid(area.points, resolution, area.world)
    points = {raster.crs: area.within(raster.crs) for layer in layers for raster in layer.rasters}
    stretches = [find_stretch(layer.rasters, points) for layer in layers]
    image, covered = np.zeros((*grid.shape, 3), np.uint8), np.zeros(grid.shape, bool)
    counts, broken = np.zeros(len(layers)), dict[str, ImageryError]()
    for part, crs_from_block in _blocks(area.world, grid, points):
        total = np.zeros((4, *covered[part].shape), np.float32)
        for number, layer in enumerate(layers):
            before = np.count_nonzero(total[3] >= HALF_SEEN)
            _lay_under(total, layer, crs_from_block, stretches[number], broken)
            counts[number] += np.count_nonzero(total[3] >= HALF_SEEN) - before
        covered[part] = total[3] >= HALF_SEEN
        image[part] = colours_of(total)
    _check_result(layers, covered, broken)
    shares = counts / covered.size
    report = _report(layers, resolution, sizes, stretches, shares, tuple(broken))
    nothing, matrix = np.zeros(grid.shape, bool), grid.world_from_grid
    return AIM(image, matrix, area.world, covered.astype(np.uint16), nothing, report)


def _blocks(
    world: World,
    grid: Grid,
    crses: Iterable[str],
) -> Iterator[tuple[tuple[slice, slice], dict[str, Float[Array, "3 3"]]]]:
    """Blocks of the image, so small that a straight map leads from each to every CRS."""
    height, width = grid.shape
    tops, lefts = range(0, height, BLOCK), range(0, width, BLOCK)
    waiting = [(top, left, BLOCK) for top in reversed(tops) for left in reversed(lefts)]
    while waiting:
        top, left, side = waiting.pop()
        if top >= height or left >= width:
            continue
        part = slice(top, min(top + side, height)), slice(left, min(left + side, width))
        world_from_block = grid.world_from_grid @ translation(left, top)
        size = part[0].stop - top, part[1].stop - left
        fits = {crs: _straight(world, world_from_block, size, crs) for crs in crses}
        if side > 16 and max(bend for _, bend in fits.values()) > BENT:
            half = side // 2
            waiting += [(top + i, left + j, half) for i in (half, 0) for j in (half, 0)]
        else:
            yield part, {crs: matrix for crs, (matrix, _) in fits.items()}


def _straight(
    world: World, world_from_block: Float[Array, "3 3"], size: tuple[int, int], crs: str
) -> tuple[Float[Array, "3 3"], float]:
    """The affine map from a block's pixels to a CRS that errs least, and by how many pixels."""
    shares = np.stack(np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 5)), axis=-1)
    pixels = shares.reshape(-1, 2) * size[::-1]
    found = crs_from_world(world, transform_points(world_from_block, pixels), crs)
    middle = found.mean(axis=0)  # taken off, since degrees and millions of metres are ill to fit
    rows = np.column_stack([pixels, np.ones(len(pixels))])
    fit = np.linalg.lstsq(rows, found - middle, rcond=None)[0]
    errors = np.linalg.solve(fit[:2].T, (found - middle - rows @ fit).T)
    matrix = np.vstack([fit.T, [0.0, 0.0, 1.0]])
    matrix[:2, 2] += middle
    return matrix, float(np.abs(errors).max())


def _lay_under(
    total: Float32[Array, "4 h w"],
    layer: Layer,
    crs_from_block: Mapping[str, Float[Array, "3 3"]],
    stretch: Stretch | None,
    broken: dict[str, ImageryError],
) -> None:
    """Add a layer where alpha still lacks; sums that alpha limits leave no seam between tiles."""
    if np.abs(total[3] - 1.0).max() < 0.001:
        return
    for raster in layer.rasters:
        if raster.name in broken:
            continue
        raster_from_block = raster.grid.grid_from_world @ crs_from_block[raster.crs]
        own = None if raster.dtype == "uint8" else stretch
        try:
            placed = place_raster(raster, raster_from_block, total.shape[1:], own)
        except ImageryError as error:
            if layer.whole:
                raise
            broken[raster.name] = error
            continue
        if placed is not None:
            rows, columns, part = placed
            there, alpha = total[:, rows, columns], part[3]
            room = np.clip((1.0 - there[3]) / np.maximum(alpha, 1e-6), 0.0, 1.0)
            there += part * np.where((alpha <= 0.0) | (there[3] + alpha <= 1.001), 1.0, room)


def _check_result(
    layers: Sequence[Layer], covered: Bool[Array, "H W"], broken: Mapping[str, ImageryError]
) -> None:
    for error in broken.values():
        warnings.warn(f"left as a hole: {error}", GeoaimWarning, stacklevel=4)
    if not covered.any():
        names = ", ".join(layer.name for layer in layers)
        raise ImageryError(
            f"{names}: nothing but nodata, transparency or missing tiles there; choose another "
            "place, or of tiles another zoom"
        )


def _report(
    layers: Sequence[Layer],
    resolution: float,
    sizes: Sequence[float],
    stretches: Sequence[Stretch | None],
    shares: Float[Array, "n"],
    broken: tuple[str, ...],
) -> dict[str, Any]:
    rows = [
        {
            "name": layer.name,
            "rasters": len(layer.rasters),
            "crs": sorted({raster.crs for raster in layer.rasters}),
            "resolution_m": size,
            "bands": sorted({raster.bands for raster in layer.rasters}),
            "zoom": layer.zoom,
            "stretch": stretch and [stretch.low, stretch.high],
            "share": share,
            "unreadable": [*layer.unreadable, *(r.name for r in layer.rasters if r.name in broken)],
        }
        for layer, size, stretch, share in zip(layers, sizes, stretches, shares, strict=True)
    ]
    covered = float(shares.sum())
    return {"source": "imagery", "resolution_m": resolution, "covered": covered, "imagery": rows}
