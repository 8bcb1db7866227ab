"""Mosaics of third-party imagery: orthophotos, tiles and tile services in one north-up AIM.

aim = read_imagery("ortho.tif")
service = Tiles("https://host/{z}/{x}/{y}.png", zoom=19)
aim = read_imagery(["ortho.tif", service], world=aim.world, corners=aim.corners)
"""

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, NamedTuple, TypedDict, Unpack

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt16
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.files import open_aim
from geoaim.base.errors import GeoaimError, GeoreferenceError, ImageryError, name_option, warn
from geoaim.base.geometry import translation
from geoaim.base.grid import Grid, fit_affine, make_north_up_grid
from geoaim.base.limits import check_memory, name_file
from geoaim.base.world import LONLAT, World, transform_crs
from geoaim.imagery import resampling
from geoaim.imagery.addresses import find_kind
from geoaim.imagery.collars import hide_collars
from geoaim.imagery.rasters import (
    Region,
    describe_extent,
    enclose_outlines,
    intersects_bounds,
    make_region,
    measure_resolution,
)
from geoaim.imagery.remote import open_remote, outline_dataset
from geoaim.imagery.sources import (
    ImageryObject,
    Layer,
    Source,
    describe_source,
    fetch_parts,
    list_sources,
    number_parts,
)

BYTES_PER_PIXEL = 8  # memory for a pixel of an image and its coverage
BLOCK_PX = 1024  # side of the blocks to begin with
MIN_BLOCK_PX = 16  # side below which blocks are not divided
MAX_AFFINE_ERROR_PX = 0.005  # largest error of the affine map from a block to a CRS
# a source whose pixels are larger than the image's by a greater factor gives a warning
MAX_UPSAMPLING = 3.0


class ReadOptions(TypedDict, total=False):
    """Options of `read_imagery`."""

    resolution: float | None
    crs: str | None
    bands: Sequence[int] | None
    nodata: float | Literal["none"] | None


class Mosaic(NamedTuple):
    """A mosaic, and which of its parts each pixel comes from."""

    aim: AIM
    # number of the part, from 1; 0 where nothing is; None where there is one part only
    labels: UInt16[Array, "H W"] | None
    names: tuple[str, ...]  # names of the parts


@dataclass(frozen=True, eq=False)
class _Source:
    """A layer, its finest resolution (m a pixel), its stretch, and errors of unreadable rasters."""

    layer: Layer
    resolution: float
    stretch: resampling.Stretch | None
    unreadable: dict[str, ImageryError] = field(default_factory=dict)


def read_imagery(
    sources: Source | ImageryObject | Sequence[Source | ImageryObject],
    *,
    world: World | None = None,
    corners: Float[Array, "n 2"] | None = None,
    **options: Unpack[ReadOptions],
) -> AIM:
    """Read imagery from one or several sources as one north-up image.

    A source is one of these:

    - a GeoTIFF, an image with a world file, or an MBTiles file,
    - a folder or a pattern of such files,
    - a folder of tiles (`z/x/y.png` or `NAME-x-y-z.png`),
    - the address of a tile service (`https://host/{z}/{x}/{y}.png`), of a GeoTIFF, a STAC item, a
      WMS or a WMTS, or a VRT of files: docs/formats/imagery.md has their forms,
    - an open dataset of rasterio, or an array of xarray with a CRS in `.rio` (needs rioxarray).

    `Tiles` has options for tiles. Colours are averaged where a source is finer than the grid, then
    resampled by cubic convolution. Nodata, masks and alpha leave holes; so do missing tiles and,
    among many files, those that cannot be read (with a warning). Values of more than 8 bits are
    stretched from their 1st to 99th percentile in the region, jointly over the bands and rasters of
    a source. Alpha bands are recognised by their colour interpretation; other bands after the third
    are ignored.

    Args:
        sources: one or several, the topmost first.
        world: plane of the image, with a CRS; None: the UTM zone of the imagery.
        corners: (N, 2) metres of `world`, whose bounds are covered; None: all the imagery.
        options: `resolution` (metres per pixel; None: that of the finest source there, to four
            digits), `crs` (of sources that name none, such as images with world files), `bands`
            (number of the grey band or of the red, green and blue ones, from 1; None: by their
            colour interpretation, else the first three, the first of fewer), `nodata` (value of
            pixels that show nothing, in all bands, of files that do not tell; "none" keeps all;
            None: of such files plain white or black at the edge shows nothing).

    Returns:
        The image; coverage is 1 where imagery is. The report has, for each source, its CRS, its
        own resolution (m), bands, zoom, stretch, and the share of the image that shows it.

    Raises:
        FileNotFoundError: a source names no file.
        ImageryError: a source cannot be read or placed, or none of them covers the region.
        AimError: the image would have more than 30,000 pixels a side.
        ValueError: no source is given, or resolution, corners or bands are invalid.
    """
    return read_mosaic(sources, world=world, corners=corners, **options).aim


def read_mosaic(
    sources: Source | ImageryObject | Sequence[Source | ImageryObject],
    *,
    world: World | None = None,
    corners: Float[Array, "n 2"] | None = None,
    **options: Unpack[ReadOptions],
) -> Mosaic:
    """Read imagery, and tell which part each pixel comes from."""
    _check_region(world, corners)
    region = None if corners is None or world is None else make_region(world, corners)
    with _fetch(list_sources(sources), region, options.get("resolution")) as listed:
        return _read_files(listed, world, region, options)


@contextmanager
def _fetch(
    listed: Iterable[Any], region: Region | None, resolution: float | None
) -> Iterator[list[Source]]:
    """Fetch what lies elsewhere into a folder of its own; errors call it by its own name."""
    with TemporaryDirectory(prefix="geoaim-") as folder:
        try:
            yield fetch_parts(listed, Path(folder), region, resolution)
        except ImageryError as error:
            fetched = rf"{re.escape(folder)}[/\\]\d+[/\\]"
            raise ImageryError(re.sub(fetched, "", str(error))) from error


def _read_files(
    listed: Sequence[Source], world: World | None, region: Region | None, options: ReadOptions
) -> Mosaic:
    """Read files, folders and services, with the options of `read_imagery`."""
    _check_options(listed, options)
    nodata = options.get("nodata")
    given: dict[str, Any] = {**options, "nodata": None if nodata == "none" else nodata}
    layers = [describe_source(source, region, **given) for source in listed]
    if region is None:
        with name_file(", ".join(layer.name for layer in layers)):
            region = enclose_outlines([line for layer in layers for line in layer.outlines], world)
    layers = _select_layers(layers, region)
    measured = [_measure_source(layer, region) for layer in layers]
    finest = float(f"{min(source.resolution for source in measured):.4g}")
    resolution = options.get("resolution") or finest
    mosaic = _compose(measured, region, resolution)
    if nodata is None:
        mosaic = _hide_collars(mosaic, layers)
    mosaic = _keep_position(mosaic, measured)
    _warn_of_upsampling(measured, resolution)
    return mosaic


def _check_options(listed: Sequence[Source], options: ReadOptions) -> None:
    resolution, bands = options.get("resolution"), options.get("bands")
    if not listed:
        raise ValueError("no source of imagery was given: name at least one")
    if resolution is not None and not (np.isfinite(resolution) and resolution > 0):
        raise ValueError(f"resolution must be a positive number of metres, found {resolution}")
    if bands is not None and len(bands) not in (1, 3):
        raise ValueError(f"bands must be one for grey or three for RGB, found {list(bands)}")


def _measure_source(layer: Layer, region: Region) -> _Source:
    """Measure a layer's finest resolution in a region, and how its contrast is stretched."""
    points = {raster.crs: region.to_crs(raster.crs) for raster in layer.rasters}
    resolution = min(measure_resolution(raster, region) for raster in layer.rasters)
    return _Source(layer, resolution, resampling.estimate_stretch(layer.rasters, points))


def _hide_collars(mosaic: Mosaic, layers: Sequence[Layer]) -> Mosaic:
    """Take plain white or black at the edge for empty, where a file does not say what is."""
    rasters = [raster for layer in layers for raster in layer.rasters]
    if all(raster.masked or raster.dtype != "uint8" for raster in rasters):
        return mosaic
    name = ", ".join(layer.name for layer in layers if layer.zoom is None)
    return mosaic._replace(aim=hide_collars(mosaic.aim, name or None))


def read_lonlat(
    sources: Source | ImageryObject | Sequence[Source | ImageryObject], crs: str | None
) -> Float[Array, "m 2"]:
    """Read longitudes and latitudes of the outlines of imagery."""
    listed, outlines = [], []
    for source in list_sources(sources):
        if isinstance(source, str) and find_kind(source) is not None:  # of which no pixel is read
            with open_remote(source, None, None) as dataset:
                outlines.append(outline_dataset(dataset))
        else:
            listed.append(source)
    with _fetch(listed, None, None) as files:
        layers = [describe_source(source, None, crs=crs) for source in files]
    outlines += [outline for layer in layers for outline in layer.outlines]
    return np.concatenate([transform_crs(own, LONLAT, points) for own, points in outlines])


def _check_region(world: World | None, corners: Float[Array, "n 2"] | None) -> None:
    if world is None and corners is not None:
        raise ValueError("corners are metres of a world: give the world, or leave both out")
    if corners is not None and not (np.isfinite(corners).all() and np.ptp(corners, axis=0).all()):
        raise ValueError(f"corners must be finite and span an area, found {corners.tolist()}")
    if world is not None and world.crs is None:
        raise ImageryError(
            "the AIM, tracks or world that should place the imagery have no CRS: build the AIM "
            "with control points or telemetry, name the tracks' CRS (--tracks-world EPSG:n, or a "
            "line '# crs: EPSG:n' in their file), or leave them out to keep the stated position"
        )


def _select_layers(layers: Sequence[Layer], region: Region) -> list[Layer]:
    """The layers that reach the region, with those of their rasters that do."""
    selected, elsewhere = [], []
    for layer in layers:
        points = {crs: _project_region(region, crs) for crs in {r.crs for r in layer.rasters}}
        rasters = tuple(r for r in layer.rasters if intersects_bounds(r, points[r.crs]))
        if rasters:
            selected.append(replace(layer, rasters=rasters))
        else:
            elsewhere.append(f"{layer.name} covers {describe_extent(layer.outlines)}")
    wanted = describe_extent([(str(region.world.crs), region.points + region.world.origin)])
    message = f"{'; '.join(elsewhere)}; imagery is needed in {wanted}"
    if not selected:
        raise ImageryError(
            f"{message}: do the imagery and what places it (an AIM, tracks, or a world and corners "
            "in metres from its origin) show the same place? Else check "
            + name_option("--crs or --tms", "crs= or tms=")
            + " of files that do not name these themselves"
        )
    if elsewhere:
        warn(message)
    return selected


def _project_region(region: Region, crs: str) -> Float[Array, "m 2"]:
    try:
        return region.to_crs(crs)
    except GeoreferenceError:  # the region is beyond what the CRS can express
        return np.full((1, 2), np.nan)


def _warn_of_upsampling(sources: Sequence[_Source], resolution: float) -> None:
    for source in sources:
        if source.resolution > MAX_UPSAMPLING * resolution:
            warn(
                f"{source.layer.name} has pixels of {source.resolution:.3g} m, and "
                f"{resolution:.3g} m were wanted: the image is no sharper than they are"
            )


def _compose(sources: Sequence[_Source], region: Region, resolution: float) -> Mosaic:
    """Resample the sources block by block, each below the ones before it."""
    with name_file(", ".join(source.layer.name for source in sources)):
        grid = make_north_up_grid(region.points, resolution, region.world)
    _check_size(sources, grid)
    image, covered = np.zeros((*grid.shape, 3), np.uint8), np.zeros(grid.shape, bool)
    counts = np.zeros(len(sources))
    parts, names = number_parts([source.layer for source in sources])
    labels = np.zeros(grid.shape, np.uint16) if len(names) > 1 else None
    crses = {raster.crs: None for source in sources for raster in source.layer.rasters}
    for block, crs_from_block in _split_into_blocks(grid, region.world, crses):
        total = np.zeros((4, *covered[block].shape), np.float32)
        for number, source in enumerate(sources):
            before = np.count_nonzero(total[3] >= resampling.MIN_ALPHA)
            below = None if labels is None else labels[block]
            _add_below(total, source, crs_from_block, parts, below)
            counts[number] += np.count_nonzero(total[3] >= resampling.MIN_ALPHA) - before
        covered[block] = total[3] >= resampling.MIN_ALPHA
        image[block] = resampling.unpremultiply(total)
    resampling.read_whole.cache_clear()
    _check_coverage(sources, covered)
    report = _make_report(sources, resolution, counts / covered.size)
    contested, matrix = np.zeros(grid.shape, bool), grid.world_from_grid
    aim = AIM(image, matrix, region.world, covered.astype(np.uint16), contested, report)
    return Mosaic(aim, labels, names)


def _keep_position(mosaic: Mosaic, sources: Sequence[_Source]) -> Mosaic:
    """Keep what the report of an AIM says of its position, if that is the only source."""
    paths = [raster.path for source in sources for raster in source.layer.rasters]
    if len(paths) != 1 or Path(paths[0]).suffix.lower() not in (".tif", ".tiff"):
        return mosaic
    try:
        with open_aim(paths[0]) as file:
            position = file.report.get("position")
    except GeoaimError:
        return mosaic  # an image that is no AIM
    stated = {} if position is None else {"position": position}
    return mosaic._replace(aim=replace(mosaic.aim, report={**mosaic.aim.report, **stated}))


def _check_size(sources: Sequence[_Source], grid: Grid) -> None:
    """Refuse an image that is far larger than the files it comes from explain."""
    files = {raster.path for source in sources for raster in source.layer.rasters}
    size = sum(os.path.getsize(file) for file in files)
    needed = BYTES_PER_PIXEL * grid.height * grid.width
    names = ", ".join(source.layer.name for source in sources)
    claim = f"{grid.height} x {grid.width} pixels"
    check_memory(names, needed, size, ImageryError, claim)


def _split_into_blocks(
    grid: Grid, world: World, crses: Iterable[str]
) -> Iterator[tuple[tuple[slice, slice], dict[str, Float[Array, "3 3"]]]]:
    """Divide an image into blocks from which affine maps (crs_from_block) lead to every CRS."""
    tops, lefts = range(0, grid.height, BLOCK_PX), range(0, grid.width, BLOCK_PX)
    waiting = [(top, left, BLOCK_PX) for top in reversed(tops) for left in reversed(lefts)]
    while waiting:
        top, left, side = waiting.pop()
        if top >= grid.height or left >= grid.width:
            continue
        shape = min(side, grid.height - top), min(side, grid.width - left)
        part = Grid(shape, grid.world_from_grid @ translation(left, top), world)
        fits = {crs: fit_affine(part, world, crs) for crs in crses}
        if side > MIN_BLOCK_PX and max(error for _, error in fits.values()) > MAX_AFFINE_ERROR_PX:
            half = side // 2
            waiting += [(top + i, left + j, half) for i in (half, 0) for j in (half, 0)]
        else:
            block = slice(top, top + shape[0]), slice(left, left + shape[1])
            yield block, {crs: matrix for crs, (matrix, _) in fits.items()}


def _add_below(
    total: Float32[Array, "4 h w"],
    source: _Source,
    crs_from_block: Mapping[str, Float[Array, "3 3"]],
    parts: Mapping[str, int],
    labels: UInt16[Array, "h w"] | None,
) -> None:
    """Add a source where alpha is below 1; sums limited by alpha leave no seam between tiles."""
    if np.abs(total[3] - 1.0).max() < 0.001:
        return
    for raster in source.layer.rasters:
        if raster.path in source.unreadable:
            continue
        raster_from_block = raster.grid.grid_from_world @ crs_from_block[raster.crs]
        stretch = None if raster.dtype == "uint8" else source.stretch
        try:
            resampled = resampling.resample_raster(
                raster, raster_from_block, total.shape[1:], stretch
            )
        except ImageryError as error:
            if source.layer.single:
                raise
            source.unreadable[raster.path] = error
            continue
        if resampled is not None:
            rows, columns, part = resampled
            below, alpha = total[:, rows, columns], part[3]
            room = np.clip((1.0 - below[3]) / np.maximum(alpha, 1e-6), 0.0, 1.0)
            below += part * np.where((alpha <= 0.0) | (below[3] + alpha <= 1.001), 1.0, room)
            if labels is not None:
                shown = (labels[rows, columns] == 0) & (below[3] >= resampling.MIN_ALPHA)
                labels[rows, columns][shown] = parts[raster.path]


def _check_coverage(sources: Sequence[_Source], covered: Bool[Array, "H W"]) -> None:
    for error in (error for source in sources for error in source.unreadable.values()):
        warn(f"file skipped, its area stays empty: {error}")
    if not covered.any():
        names = ", ".join(source.layer.name for source in sources)
        raise ImageryError(
            f"{names}: nothing but nodata, transparency or missing tiles there; choose another "
            "place, or for tiles another zoom"
        )


def _make_report(
    sources: Sequence[_Source], resolution: float, shares: Float[Array, "n"]
) -> dict[str, Any]:
    rows = [
        {
            "name": layer.name,
            "rasters": len(layer.rasters),
            "crs": sorted({raster.crs for raster in layer.rasters}),
            "resolution_m": source.resolution,
            "bands": sorted({raster.bands for raster in layer.rasters}),
            "zoom": layer.zoom,
            "stretch": source.stretch and list(source.stretch),
            "share": share,
            "unreadable": [*layer.unreadable, *source.unreadable],
        }
        for source, share in zip(sources, shares, strict=True)
        for layer in [source.layer]
    ]
    covered = float(shares.sum())
    return {"source": "imagery", "resolution_m": resolution, "covered": covered, "imagery": rows}
