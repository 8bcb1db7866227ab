"""Rasters and tiles of painted ground, whose colours tell where each pixel should lie."""

import warnings
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import rasterio
import rasterio.shutil
from rasterio.transform import Affine, from_origin

from geoaim.aim.aim import AIM
from geoaim.base.geometry import transform_points
from geoaim.base.world import World, transform_crs
from geoaim.imagery.tiles import HALF_WORLD_M

WORLD = World("EPSG:32633", (600_000.0, 5_340_000.0))  # Vienna

HERE = np.array(WORLD.origin)

BOX = np.array([[-60.0, -40.0], [60.0, 40.0]])

AREA = {"world": WORLD, "corners": BOX, "resolution": 0.5}


def centres(height: int, width: int) -> np.ndarray:
    grid = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack(grid, axis=-1).reshape(-1, 2)


def paint(places: np.ndarray, wave: float = 15.0) -> np.ndarray:
    """Smooth colours (0 to 255) of places in the world's CRS, waves of so many metres."""
    x, y = (places - HERE).T * 2 * np.pi / wave
    return 127.5 + 90 * np.stack([np.sin(x), np.cos(y), np.sin(0.6 * x + 0.8 * y)], axis=-1)


def painted(crs: str, place: np.ndarray, shape: tuple[int, int], wave: float) -> np.ndarray:
    points = transform_points(place, centres(*shape))
    colours = paint(transform_crs(crs, WORLD.crs, points), wave)
    return np.moveaxis(np.rint(colours).astype(np.uint8).reshape(*shape, 3), -1, 0)


def place_around(crs: str, pixel: float, shape: tuple[int, int], turn: float = 0.0) -> np.ndarray:
    """crs_from_raster of a raster amid HERE with pixels of about so many metres."""
    around = transform_crs(WORLD.crs, crs, HERE + np.array([[0, 0], [pixel, 0], [0, pixel]]))
    sizes = np.linalg.norm(around[1:] - around[0], axis=1)
    cos, sin = np.cos(turn), np.sin(turn)
    matrix = np.array([[sizes[0] * cos, sizes[0] * sin], [sizes[1] * sin, -sizes[1] * cos]])
    middle = matrix @ [shape[1] / 2 + 0.3, shape[0] / 2 - 0.2]
    return np.vstack([np.column_stack([matrix, around[0] - middle]), [0, 0, 1]])


def write(path: Path, bands: np.ndarray, crs: str | None, place: np.ndarray, **profile) -> Path:
    profile = {"driver": "GTiff", "dtype": bands.dtype, "crs": crs, **profile}
    transform = Affine(*place[:2].flat) if place is not None else None
    shape = dict(zip(("count", "height", "width"), bands.shape, strict=True))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", transform=transform, **shape, **profile) as dataset:
            dataset.write(bands)
    return path


def ortho(path: Path, crs: str = "EPSG:32633", pixel: float = 0.5, side: int = 320, **more) -> Path:
    place = place_around(crs, pixel, (side, side))
    return write(path, painted(crs, place, (side, side), 15.0), crs, place, **more)


def flat(tmp_path: Path, bands: np.ndarray, name: str = "a.tif", **profile) -> Path:
    """A raster of 0.5 m pixels amid BOX."""
    height, width = bands.shape[1:]
    place = np.array(from_origin(*(HERE - [width / 4, -height / 4]), 0.5, 0.5)).reshape(3, 3)
    return write(tmp_path / name, bands, "EPSG:32633", place, **profile)


def constant(*values: float, dtype: str = "uint8", side: int = 80) -> np.ndarray:
    return np.stack([np.full((side, side), value, dtype) for value in values])


def misplaced(aim: AIM, wave: float, rows: int = 3) -> float:
    """By how many pixels parts of an image of painted ground are off, at most."""
    height, width = aim.coverage.shape
    points = transform_points(aim.world_from_image, centres(height, width)) + aim.world.origin
    step = aim.world_from_image[0, 0]
    slopes = [
        (paint(points + d, wave) - paint(points - d, wave)) / 2
        for d in ([step / 2, 0], [0, step / 2])
    ]
    slopes = np.stack(slopes, axis=-1).reshape(height, width, 3, 2) * 2
    wrong = aim.image - paint(points, wave).reshape(height, width, 3)
    inside = cv2.erode(aim.coverage.astype(np.uint8), np.ones((9, 9)), borderValue=0) > 0
    found = []
    for part in np.array_split(np.arange(height), rows):
        for across in np.array_split(np.arange(width), rows):
            cell = np.ix_(part, across)
            use = inside[cell]
            if use.sum() > 100:
                a, b = slopes[cell][use].reshape(-1, 2), wrong[cell][use].reshape(-1)
                found.append(np.abs(np.linalg.lstsq(a, b, rcond=None)[0]).max())
    assert found
    return max(found)


def tile_place(zoom: int, x: int, y: int, side: int = 256) -> np.ndarray:
    span = 2 * HALF_WORLD_M / 2**zoom
    place = from_origin(x * span - HALF_WORLD_M, HALF_WORLD_M - y * span, span / side, span / side)
    return np.array(place).reshape(3, 3)


def tiles_here(zoom: int) -> list[tuple[int, int, int]]:
    mercator = transform_crs(WORLD.crs, "EPSG:3857", HERE + BOX * 1.2)
    x, y = ((mercator * [1, -1] + HALF_WORLD_M) / (2 * HALF_WORLD_M) * 2**zoom).astype(int).T
    return [(zoom, i, j) for i in range(x.min(), x.max() + 1) for j in range(y.min(), y.max() + 1)]


@lru_cache(maxsize=64)
def tile_png(zoom: int, x: int, y: int, side: int = 256, alpha: int | None = None) -> bytes:
    bands = painted("EPSG:3857", tile_place(zoom, x, y, side), (side, side), 15.0)
    rgb = np.moveaxis(bands, 0, -1)
    if alpha is not None:
        rgb = np.dstack([rgb, np.full((side, side), alpha, np.uint8)])
        return cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGBA2BGRA))[1].tobytes()
    return cv2.imencode(".png", rgb[..., ::-1])[1].tobytes()


def write_tiles(folder: Path, zoom: int, name: str = "{z}/{x}/{y}.png") -> Path:
    for z, x, y in tiles_here(zoom):
        file = folder / name.format(z=z, x=x, y=y, tms=2**z - 1 - y)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(tile_png(z, x, y))
    return folder
