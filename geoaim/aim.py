"""AIM: an image of the ground and the place where it lies in the world."""

import json
import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from jaxtyping import Bool, Float, UInt8, UInt16
from numpy import ndarray as Array
from pyproj import CRS
from rasterio._err import CPLE_BaseError
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from geoaim.errors import AimError
from geoaim.files import atomic_write
from geoaim.geometry import image_corners, to_opencv, transform_points
from geoaim.grid import Grid, north_up_grid
from geoaim.world import World

FORMAT = 1
BANDS = ("red", "green", "blue", "alpha", "contested", "coverage, low byte", "coverage, high byte")
BLOCK = 1024  # px: side of the blocks that are resampled at a time


@dataclass(frozen=True, eq=False)
class AIM:
    """Aerial image-based map.

    Attributes:
        image: (H, W, 3) RGB.
        world_from_image: (3, 3) pixels (corner origin, u right, v down) to world metres.
        world: the plane that those metres lie in.
        coverage: (H, W) number of frames behind each pixel; 0 where nothing was seen.
        contested: (H, W) pixels whose background the frames do not settle.
        report: how far to trust it. Kept as plain JSON: arrays become lists, and numbers that
            do not exist (NaN, infinity) become None.

    Raises:
        ValueError: a field has a wrong type or shape, or the matrix has no inverse.
        AimError: part of the image lies at or behind the horizon.
    """

    image: UInt8[Array, "H W 3"]
    world_from_image: Float[Array, "3 3"]
    world: World
    coverage: UInt16[Array, "H W"]
    contested: Bool[Array, "H W"]
    report: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        height, width = (*np.shape(self.image), 0, 0)[:2]
        _check("image", self.image, np.uint8, (height, width, 3))
        _check("world_from_image", self.world_from_image, np.float64, (3, 3))
        _check("coverage", self.coverage, np.uint16, (height, width))
        _check("contested", self.contested, np.bool_, (height, width))
        if height * width == 0:
            raise ValueError(f"image has no pixels: its shape is {self.image.shape}")
        _check_place(self.world_from_image, height, width)
        object.__setattr__(self, "report", _plain_json(self.report))

    @classmethod
    def from_image(
        cls,
        image: UInt8[Array, "H W 3"],
        world_from_image: Float[Array, "3 3"],
        world: World,
        source: str,
    ) -> "AIM":
        """Make an AIM from one georeferenced image that covers each of its pixels.

        Args:
            image: (H, W, 3) RGB.
            world_from_image: (3, 3) pixels to world metres.
            world: the plane that those metres lie in.
            source: where the image comes from; the whole report.

        Returns:
            An AIM with a coverage of 1 everywhere and no contested pixels.
        """
        size = np.shape(image)[:2]
        coverage, contested = np.ones(size, np.uint16), np.zeros(size, bool)
        return cls(image, world_from_image, world, coverage, contested, {"source": source})

    @property
    def grid(self) -> Grid:
        """The image's pixels in the world."""
        height, width = self.image.shape[:2]
        return Grid((height, width), self.world_from_image, self.world)

    @property
    def corners(self) -> Float[Array, "4 2"]:
        """Corner frame: image corners in world metres, top-left, then clockwise in the image."""
        return self.grid.corners

    @property
    def resolution(self) -> float:
        """Metres per pixel at the image centre."""
        return self.grid.resolution

    @property
    def is_affine(self) -> bool:
        """Whether straight pixels lie evenly on the ground, as a GeoTIFF or a texture needs."""
        return bool(np.array_equal(self.world_from_image[2], [0.0, 0.0, 1.0]))


def write_aim(aim: AIM, path: str | os.PathLike[str], *, resolution: float | None = None) -> None:
    """Write an AIM as one GeoTIFF (cloud-optimised, lossless) that GIS programs open in place.

    Bands: red, green, blue, alpha (255 where a frame saw the ground), contested (255 where so),
    and the low and high bytes of the coverage. The world, the exact matrix and the report stand
    in the tags GEOAIM and GEOAIM_REPORT. A file of that name is replaced only when the new one
    is complete.

    Args:
        aim: what to write. It is rectified first when its transform is not affine, since a
            GeoTIFF has no perspective, or when a resolution is given.
        path: the .tif file.
        resolution: metres a pixel of the file; the image's own when None.

    Raises:
        AimError: the grid would be too large, or the file cannot be written.
    """
    if resolution is not None or not aim.is_affine:
        aim = rectify(aim, resolution)
    height, width = aim.coverage.shape
    profile = {
        "driver": "COG",
        "height": height,
        "width": width,
        "count": len(BANDS),
        "dtype": "uint8",
        "crs": aim.world.crs,
        "transform": rasterio.Affine(*_crs_from_image(aim.world, aim.world_from_image)[:2].flat),
        "compress": "deflate",
        "predictor": "yes",
        "num_threads": "all_cpus",
    }
    try:
        with (
            atomic_write(path) as temporary,
            _unplaced_is_fine(),
            rasterio.open(temporary, "w", **profile) as dataset,
        ):
            _write_bands(dataset, aim)
    except (RasterioError, CPLE_BaseError) as error:
        raise AimError(f"{path} could not be written: {error}") from error


def read_aim(path: str | os.PathLike[str]) -> AIM:
    """Read what `write_aim` wrote.

    A file that a GIS program has cropped or resampled since keeps its new place, as long as its
    CRS and bands are the same.

    Raises:
        FileNotFoundError: there is no such file.
        AimError: the file is not an AIM; the message says what it is.
    """
    if not Path(path).exists():
        raise FileNotFoundError(f"{path}: no such file")
    try:
        with _unplaced_is_fine(), rasterio.open(path) as dataset:
            frame = _read_frame(dataset, path)
            world = World(crs=frame["world"]["crs"], origin=tuple(frame["world"]["origin"]))
            return AIM(
                image=np.ascontiguousarray(np.moveaxis(dataset.read([1, 2, 3]), 0, -1)),
                world_from_image=_read_place(dataset, world, frame, path),
                world=world,
                coverage=dataset.read(6) + dataset.read(7).astype(np.uint16) * 256,
                contested=dataset.read(5) > 0,
                report=json.loads(dataset.tags().get("GEOAIM_REPORT", "{}")),
            )
    except RasterioError as error:
        raise AimError(f"{path} is not a readable GeoTIFF: {error}") from error


def rectify(aim: AIM, resolution: float | None = None) -> AIM:
    """Resample an AIM to a north-up grid of square pixels; its lines lie on whole multiples.

    Colours by bicubic interpolation, averaged where the grid is coarser than the image;
    coverage and contested from the nearest pixel. Outside the image the coverage is 0.

    Args:
        aim: what to resample.
        resolution: metres a pixel; the median ground size of a pixel, to two digits, when None.

    Raises:
        AimError: the grid would have more than 30,000 pixels a side.
    """
    sides = _pixel_sides(aim)
    if resolution is None:
        resolution = float(f"{np.median(np.sqrt(sides.prod(axis=1))):.2g}")
    grid = north_up_grid(aim.corners, resolution)
    image_from_grid = aim.grid.grid_from_world @ grid.world_from_grid
    oversampling = int(np.clip(round(resolution / sides.min()), 1, BLOCK))
    coverage = _nearest(aim.coverage, image_from_grid, grid.shape)
    contested = _nearest(aim.contested.astype(np.uint8), image_from_grid, grid.shape)
    image = _resample(aim, image_from_grid, grid.shape, oversampling)
    image[coverage == 0] = 0
    return replace(
        aim,
        image=image,
        world_from_image=grid.world_from_grid,
        coverage=coverage,
        contested=contested > 0,
    )


def _check(name: str, found: Any, dtype: type, shape: tuple[int, ...]) -> None:
    if getattr(found, "dtype", None) != dtype or found.shape != shape:
        what = f"{found.dtype} {found.shape}" if hasattr(found, "dtype") else type(found).__name__
        raise ValueError(f"{name} must be {np.dtype(dtype)} {shape}, found {what}")


def _check_place(world_from_image: Float[Array, "3 3"], height: int, width: int) -> None:
    if not np.isfinite(world_from_image).all() or np.linalg.det(world_from_image) == 0:
        raise ValueError(f"world_from_image must be finite and invertible:\n{world_from_image}")
    depth = image_corners(height, width) @ world_from_image[2, :2] + world_from_image[2, 2]
    if not ((depth > 0).all() or (depth < 0).all()):
        raise AimError(
            "the image reaches past the horizon: its corners have depths "
            f"{np.round(depth, 3).tolist()} of both signs; crop it to the ground, or give control "
            "points that are spread over the whole image"
        )


def _plain_json(report: Mapping[str, Any]) -> dict[str, Any]:
    text = json.dumps(dict(report), default=lambda value: value.tolist())
    plain: dict[str, Any] = json.loads(text, parse_constant=lambda _: None)
    return plain


def _crs_from_image(world: World, world_from_image: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    crs_from_world = np.eye(3)
    crs_from_world[:2, 2] = world.origin
    return crs_from_world @ world_from_image


@contextmanager
def _unplaced_is_fine() -> Iterator[None]:
    # an AIM whose pixels are its metres has the identity as its transform
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        yield


def _write_bands(dataset: Any, aim: AIM) -> None:
    dataset.write(np.moveaxis(aim.image, -1, 0), [1, 2, 3])
    dataset.write(np.where(aim.coverage > 0, np.uint8(255), np.uint8(0)), 4)
    dataset.write(np.where(aim.contested, np.uint8(255), np.uint8(0)), 5)
    dataset.write((aim.coverage & 255).astype(np.uint8), 6)
    dataset.write((aim.coverage >> 8).astype(np.uint8), 7)
    dataset.write_mask(aim.coverage > 0)  # GDAL heeds alpha among four bands only; QGIS either
    colours = [ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha]
    dataset.colorinterp = colours + [ColorInterp.undefined] * (len(BANDS) - 4)
    dataset.descriptions = BANDS
    frame = {
        "format": FORMAT,
        "world": {"crs": aim.world.crs, "origin": list(aim.world.origin)},
        "world_from_image": aim.world_from_image.tolist(),
    }
    dataset.update_tags(GEOAIM=json.dumps(frame), GEOAIM_REPORT=json.dumps(aim.report))


def _read_frame(dataset: Any, path: str | os.PathLike[str]) -> dict[str, Any]:
    found = f"{dataset.count} band(s) of {dataset.dtypes[0]}, CRS {dataset.crs or 'absent'}"
    tag = dataset.tags().get("GEOAIM")
    if tag is None:
        raise AimError(
            f"{path} is a {dataset.driver} with {found}, and no GEOAIM tag: it is a picture, and "
            "an AIM also has a world, coverage and a report; give what `geoaim build`, "
            "`align` or `draw` wrote, or write_aim"
        )
    frame: dict[str, Any] = json.loads(tag)
    if frame["format"] != FORMAT:
        raise AimError(f"{path} has AIM format {frame['format']}; this version reads {FORMAT}")
    if dataset.descriptions != BANDS or set(dataset.dtypes) != {"uint8"}:
        raise AimError(f"{path} was an AIM and has lost bands: found {found}, needed uint8 {BANDS}")
    return frame


def _read_place(
    dataset: Any, world: World, frame: Mapping[str, Any], path: str | os.PathLike[str]
) -> Float[Array, "3 3"]:
    written = np.array(frame["world_from_image"], np.float64)
    found = np.array(dataset.transform, np.float64).reshape(3, 3)
    if np.allclose(found, _crs_from_image(world, written), rtol=1e-12, atol=1e-9):
        return written
    crs = dataset.crs and CRS(dataset.crs.to_wkt())
    if crs != (world.crs and CRS(world.crs)):
        raise AimError(
            f"{path} was reprojected: its world is in {world.crs} and the file in {dataset.crs}; "
            "give the file that write_aim wrote, or one cropped without reprojection"
        )
    found[:2, 2] -= world.origin
    return found


def _pixel_sides(aim: AIM) -> Float[Array, "m 2"]:
    """Ground lengths (m) of pixel widths and heights, on a grid over the image."""
    height, width = aim.coverage.shape
    across, down = np.linspace(0.5, width - 0.5, 33), np.linspace(0.5, height - 0.5, 33)
    points = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    steps = [
        transform_points(aim.world_from_image, points + half)
        - transform_points(aim.world_from_image, points - half)
        for half in ([0.5, 0.0], [0.0, 0.5])
    ]
    return np.linalg.norm(steps, axis=-1).T


def _nearest(raster: Array, image_from_grid: Float[Array, "3 3"], shape: tuple[int, int]) -> Array:
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    return cv2.warpPerspective(raster, to_opencv(image_from_grid), shape[::-1], flags=flags)


def _resample(
    aim: AIM, image_from_grid: Float[Array, "3 3"], shape: tuple[int, int], oversampling: int
) -> UInt8[Array, "H W 3"]:
    """Colours of covered pixels only: each is weighted by alpha, and divided by it at the end."""
    source = np.empty((*aim.coverage.shape, 4), np.float32)  # floats: bicubic sums overshoot
    source[..., 3] = aim.coverage > 0
    np.multiply(aim.image, source[..., 3:], out=source[..., :3])
    height, width = shape
    image = np.empty((height, width, 3), np.uint8)
    size = BLOCK // oversampling
    for top, left in product(range(0, height, size), range(0, width, size)):
        rows, columns = min(size, height - top), min(size, width - left)
        scale = 1.0 / oversampling
        grid_from_block = np.array([[scale, 0.0, left], [0.0, scale, top], [0.0, 0.0, 1.0]])
        fine = cv2.warpPerspective(
            source,
            to_opencv(image_from_grid @ grid_from_block),
            (columns * oversampling, rows * oversampling),
            flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        )
        block = cv2.resize(fine, (columns, rows), interpolation=cv2.INTER_AREA)
        colours = block[..., :3] / np.maximum(block[..., 3:], 0.01)
        image[top : top + rows, left : left + columns] = np.clip(np.rint(colours), 0, 255)
    return image
