"""The image that is being drawn, and how shapes are drawn on it.

Plan metres are metres on the ground, x east and y north, from the middle of the drawn extent.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import shapely
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array
from shapely import Geometry

from benchmarks.synthetic.roads.plan import HEIGHT_M, WIDTH_M
from benchmarks.synthetic.scenery import texture
from geoaim.base.geometry import transform_points

TILE = 2048  # px, side at most of the noise that is repeated over the canvas
# spectral slopes of the four fields: grain, blotches, patches, hills
SLOPES = (0.35, 0.9, 1.4, 1.9)
GRAIN, BLOTCH, PATCH, HILL = range(4)
Line = Float[Array, "_ 2"]
Shape: TypeAlias = "Geometry | Line | Sequence[Line]"
Window: TypeAlias = tuple[slice, slice]


@dataclass(frozen=True, eq=False)
class Canvas:
    """The image being drawn (changed in place), with the noise for its textures."""

    image: Float32[Array, "H W 3"]  # RGB in grey levels, 0 to 255; beyond until `grade_colours`
    image_from_plan: Float[Array, "3 3"]  # plan metres to pixels, a scale and a flip
    resolution: float  # metres per pixel
    generator: np.random.Generator  # source of randomness
    # noise of four slopes; each stroke crops another part
    fields: tuple[Float32[Array, "_ _"], ...]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.image.shape[0], self.image.shape[1]

    @property
    def window(self) -> Window:
        """The whole image."""
        return slice(0, self.shape[0]), slice(0, self.shape[1])


def make_canvas(resolution: float, generator: np.random.Generator) -> Canvas:
    """Make a black canvas of the drawn extent; the resolution is in metres per pixel."""
    rows, columns = round(HEIGHT_M / resolution), round(WIDTH_M / resolution)
    scale = 1 / resolution
    image_from_plan = np.array([[scale, 0, columns / 2], [0, -scale, rows / 2], [0, 0, 1.0]])
    tile = min(TILE, 1 << (max(rows, columns) - 1).bit_length())
    fields = tuple(texture.make_natural_noise((tile, tile), slope, generator) for slope in SLOPES)
    image = np.zeros((rows, columns, 3), np.float32)
    return Canvas(image, image_from_plan, resolution, generator, fields)


def sample_noise(canvas: Canvas, field: int, window: Window | None = None) -> Float32[Array, "h w"]:
    """Crop noise at a random position of one of the canvas's fields.

    Args:
        canvas: the canvas.
        field: `GRAIN`, `BLOTCH`, `PATCH` or `HILL`, from fine noise to broad.
        window: slices of the canvas's rows and columns, whose size the result has; None: all.

    Returns:
        (h, w) noise, whose field has mean 0 and variance 1.
    """
    rows, columns = window or canvas.window
    tile = len(canvas.fields[field])
    down, right = canvas.generator.integers(0, tile, 2)
    row = (np.arange(rows.start, rows.stop) + down) % tile
    column = (np.arange(columns.start, columns.stop) + right) % tile
    return np.asarray(canvas.fields[field][np.ix_(row, column)])


def rasterize_shape(
    canvas: Canvas, shape: Shape, *, within: Window | None = None
) -> tuple[Window, UInt8[Array, "h w"]]:
    """Rasterize a shape, anti-aliased.

    Args:
        canvas: the canvas.
        shape: polygons in plan metres.
        within: window of the mask; None takes the bounding box of the shape.

    Returns:
        The window, and the mask in it, 0 to 255.
    """
    matrix = canvas.image_from_plan
    polygons = [[transform_points(matrix, r) for r in rings] for rings in _iterate_rings(shape)]
    if within is None:
        every = np.concatenate([rings[0] for rings in polygons]) if polygons else np.zeros((1, 2))
        low = np.floor(every.min(axis=0)).astype(int) - 2
        high = np.ceil(every.max(axis=0)).astype(int) + 2
        left, top = low.clip(0, canvas.shape[::-1]).tolist()
        right, bottom = high.clip(0, canvas.shape[::-1]).tolist()
        within = slice(top, bottom), slice(left, right)
    rows, columns = within
    start = np.array([columns.start, rows.start])
    moved = [[ring - start for ring in rings] for rings in polygons]
    return within, texture.rasterize_polygons(
        (rows.stop - rows.start, columns.stop - columns.start), moved
    )


def fill(
    canvas: Canvas,
    shape: Shape,
    colour: texture.Colour,
    *,
    strength: float = 1.0,
    grain: Sequence[tuple[int, float]] = (),
    only: Geometry | None = None,
) -> None:
    """Fill a shape with a colour that varies by noise.

    Args:
        canvas: the canvas, changed in place.
        shape: polygons in plan metres; their union is filled.
        colour: mean RGB colour, 0 to 255.
        strength: opacity, 0 to 1.
        grain: noise fields and their standard deviations in grey levels.
        only: area to which drawing is clipped.
    """
    window, mask = rasterize_shape(canvas, shape)
    if not mask.any():
        return
    alpha = mask.astype(np.float32) * np.float32(strength / 255)
    if only is not None:
        alpha *= texture.to_share(rasterize_shape(canvas, only, within=window)[1])
    paint = np.asarray(colour, np.float32)
    if grain:
        light = sum(np.float32(size) * sample_noise(canvas, field, window) for field, size in grain)
        paint = paint + np.asarray(light, np.float32)[..., None]
    texture.blend(canvas.image[window], alpha, paint)


def make_circle(centre: Float[Array, "2"], radius: float) -> Float[Array, "24 2"]:
    """Make a circle as a polygon of 24 corners, in the unit of its centre and radius."""
    turn = np.linspace(0, 2 * np.pi, 25)[:-1]
    return radius * np.stack([np.cos(turn), np.sin(turn)], axis=1) + centre


def make_rectangle(
    centre: Float[Array, "2"], size: tuple[float, float], angle: float
) -> Float[Array, "4 2"]:
    """Make a rotated rectangle.

    Args:
        centre: metres.
        size: length and width, metres.
        angle: direction of the length, radians.

    Returns:
        (4, 2) corners, metres.
    """
    half = np.array(size) / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return half @ turn + centre


def _iterate_rings(shape: Shape) -> Iterator[list[Line]]:
    """Iterate over the polygons of a shape: outline and holes of each."""
    if isinstance(shape, Geometry):
        for part in shapely.get_parts(shape):
            if part.geom_type == "Polygon" and not part.is_empty:
                yield [np.array(ring.coords) for ring in (part.exterior, *part.interiors)]
    elif isinstance(shape, np.ndarray):
        yield [shape]
    else:
        yield from ([line] for line in shape)
