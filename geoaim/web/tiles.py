"""Rasters in tiles: a north-up picture at full and at halved resolutions."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array
from rasterio.windows import Window

from geoaim.base.grid import Grid

TILE_PX = 512
Colours = UInt8[Array, "h w 4"]  # red, green, blue, alpha
# rows and columns (start, stop) in pixels of the grid, and the wanted height and width
ReadBlock = Callable[[tuple[int, int], tuple[int, int], tuple[int, int]], Colours]


@dataclass(frozen=True, eq=False)
class TiledRaster:
    """A north-up raster whose blocks are read when they are wanted."""

    grid: Grid
    read_block: ReadBlock
    lock: Lock = field(default_factory=Lock, repr=False)

    @property
    def levels(self) -> int:
        """Number of resolutions; level 0, the coarsest, is one tile."""
        return 1 + max(0, math.ceil(math.log2(max(self.grid.shape) / TILE_PX)))

    def describe(self) -> dict[str, Any]:
        """Describe the tiles for the viewer: extent in metres, m per pixel, side of a tile."""
        left, bottom = self.grid.corners.min(axis=0).tolist()
        right, top = self.grid.corners.max(axis=0).tolist()
        finest = self.grid.world_from_grid[0, 0]
        factors = [2**level for level in reversed(range(self.levels))]
        return {
            "extent": [left, bottom, right, top],
            "resolutions": [float(finest * factor) for factor in factors],
            "tile_px": TILE_PX,
        }

    def encode_tile(self, level: int, column: int, row: int) -> bytes:
        """Encode a tile: JPEG, or PNG where a part of it is transparent."""
        if not 0 <= level < self.levels or column < 0 or row < 0:
            raise KeyError(f"there is no level {level} or tile {column}, {row}")
        factor = 2 ** (self.levels - 1 - level)
        side = TILE_PX * factor
        rows = (row * side, min((row + 1) * side, self.grid.height))
        columns = (column * side, min((column + 1) * side, self.grid.width))
        if rows[0] >= rows[1] or columns[0] >= columns[1]:
            raise KeyError(f"there is no tile {column}, {row} in level {level}")
        size = (
            math.ceil((rows[1] - rows[0]) / factor),
            math.ceil((columns[1] - columns[0]) / factor),
        )
        with self.lock:
            block = self.read_block(rows, columns, size)
        below, right = TILE_PX - size[0], TILE_PX - size[1]
        # the viewer clips at the extent; what it shows of a pixel beyond it is the edge's colour
        tile = cv2.copyMakeBorder(block, 0, below, 0, right, cv2.BORDER_REPLICATE)
        return encode_picture(tile)

    def list_tiles(self, max_pixels: float) -> list[tuple[int, int, int]]:
        """List level, column and row of the tiles of all levels of at most so many pixels."""
        tiles = []
        for level in range(self.levels):
            factor = 2 ** (self.levels - 1 - level)
            rows, columns = (math.ceil(side / factor / TILE_PX) for side in self.grid.shape)
            if level and self.grid.height * self.grid.width / factor**2 > max_pixels:
                break
            tiles += [(level, column, row) for row in range(rows) for column in range(columns)]
        return tiles


def encode_picture(picture: UInt8[Array, "h w c"]) -> bytes:
    """Encode RGB or RGBA: JPEG, or PNG where a part of it is transparent."""
    if picture.shape[2] == 4 and picture[..., 3].min() < 255:
        colours = cv2.cvtColor(picture, cv2.COLOR_RGBA2BGRA)
        return cv2.imencode(".png", colours, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
    colours = np.ascontiguousarray(picture[..., 2::-1])
    return cv2.imencode(".jpg", colours, [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes()


def tile_array(pixels: Colours, grid: Grid) -> TiledRaster:
    """Make tiles of an image in memory; its grid is north up."""
    halved = [pixels]

    def read_block(
        rows: tuple[int, int], columns: tuple[int, int], size: tuple[int, int]
    ) -> Colours:
        step = round(math.log2(max(1.0, (rows[1] - rows[0]) / size[0])))
        while len(halved) <= step:
            last = halved[-1]
            even = cv2.copyMakeBorder(
                last, 0, last.shape[0] % 2, 0, last.shape[1] % 2, cv2.BORDER_REPLICATE
            )
            half = (even.shape[1] // 2, even.shape[0] // 2)
            halved.append(cv2.resize(even, half, interpolation=cv2.INTER_AREA))
        top, left = rows[0] >> step, columns[0] >> step
        return halved[step][top : top + size[0], left : left + size[1]]

    return TiledRaster(grid, read_block)


def tile_file(read: Callable[..., Colours], grid: Grid) -> TiledRaster:
    """Make tiles of what is read with rasterio's options `window` and `out_shape`, north up."""

    def read_block(
        rows: tuple[int, int], columns: tuple[int, int], size: tuple[int, int]
    ) -> Colours:
        return read(window=Window.from_slices(rows, columns), out_shape=size)

    return TiledRaster(grid, read_block)
