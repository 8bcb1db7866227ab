"""Which pixels boxes touch, and how much of each they cover; with gradients, by numpy."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from geoaim.rendering.boxes import StackedBoxes
from geoaim.rendering.coverage import differentiate_overlap, measure_overlap
from geoaim.rendering.ground import View


@dataclass(frozen=True, eq=False)
class Canvas:
    """What is painted on: V pictures of their cameras."""

    view: View
    cameras: Float[Array, "V 3"]
    present: Bool[Array, "V 1"] | None  # which cameras exist; None: all
    planes: int  # channels for layers, after the ground's; 0: boxes are painted in colour


@dataclass(frozen=True, eq=False)
class PixelBoxes:
    """The n boxes that may touch their views, in pixels ahead and left of the views' middles."""

    view: Int[Array, "n"]
    column: Int[Array, "n"]  # index among the boxes of the scene
    source: Int[Array, "n"]  # index among the boxes of all scenes
    place: Float[Array, "2 n"]
    cosine: Float[Array, "n"]  # of the heading
    sine: Float[Array, "n"]
    half: Float[Array, "2 n"]  # half of length and width

    def take(self, values: Float[Array, "_ N K"]) -> Float[Array, "K n"]:
        """Take the values of these boxes, which all scenes share or not."""
        index = self.column if len(values) == 1 else self.source
        return values.reshape(-1, values.shape[2]).take(index, axis=0).T

    def scatter(self, grads: Float[Array, "K n"], shape: tuple[int, ...]) -> Float[Array, "_ N K"]:
        """Add up the gradients of what was taken."""
        index, count = self.column if shape[0] == 1 else self.source, shape[0] * shape[1]
        return sum_by(index, grads, count).T.reshape(shape)


@dataclass(frozen=True, eq=False)
class Fragments:
    """What boxes cover of m pixels; a pixel may occur several times."""

    box: Int[Array, "m"]
    pixel: Int[Array, "m"]  # index in the pictures, as if they had one channel
    x: Float[Array, "2 m"]  # place of the pixel's centre along and across the box
    share: Float[Array, "m"]  # share of the pixel that the box covers


def sum_by(index: Int[Array, "m"], values: Float[Array, "K m"], count: int) -> Array:
    """Add up values with the same index."""
    sums = [np.bincount(index, one, minlength=count) for one in values]
    return np.array(sums, np.float64)  # of no values, bincount makes integers


def find_boxes(canvas: Canvas, boxes: StackedBoxes) -> PixelBoxes:
    """Find the boxes that are present and near the views of their scenes.

    Raises:
        ValueError: the pose of a present box is not finite, or its size is not positive.
    """
    view, (poses, sizes, present) = canvas.view, _read_boxes(boxes)
    scenes, count, _ = poses.shape
    cameras = canvas.cameras.reshape(scenes, len(canvas.cameras) // max(1, scenes), 3)
    # (scenes, views, boxes) each
    x, y, turn = poses.transpose(2, 0, 1)[:, :, None] - cameras.transpose(2, 0, 1)[..., None]
    half = sizes.transpose(2, 0, 1) / (2 * view.resolution)
    reach = half[0] + half[1] + (math.hypot(view.height, view.width) / 2 + 1)
    near = np.hypot(x, y) < reach[:, None] * view.resolution
    if present is not None:
        near &= present[:, None]
    if canvas.present is not None:
        near &= canvas.present.reshape(*cameras.shape[:2], 1)
    index = near.ravel().nonzero()[0]
    camera = index // count
    column, source = index - camera * count, index
    if cameras.shape[1] != 1:
        source = camera // cameras.shape[1] * count + column
    x, y, turn = (values.ravel().take(index) for values in (x, y, turn))
    headings = canvas.cameras[:, 2].take(camera)
    cosine, sine = (f(headings) / view.resolution for f in (np.cos, np.sin))
    place = np.empty((2, len(index)), x.dtype)
    place[0] = x * cosine + y * sine
    place[1] = y * cosine - x * sine
    half = half.reshape(2, -1).take(column if len(sizes) == 1 else source, axis=1)
    return PixelBoxes(camera, column, source, place, np.cos(turn), np.sin(turn), half)


def _read_boxes(boxes: StackedBoxes) -> tuple[Array, Array, Array | None]:
    """Read poses, sizes and presence; absent boxes, which may hold any numbers, get others."""
    poses, sizes = boxes.poses.numpy(force=True), boxes.sizes.numpy(force=True)
    present = None
    if boxes.present is not None:
        present = boxes.present.numpy(force=True)
        poses = np.where(present[..., None], poses, 0)
        sizes = np.where(present[..., None], sizes, 1)
    # sums are finite where all numbers are
    if not (math.isfinite(poses.sum()) and math.isfinite(sizes.sum()) and sizes.min(initial=1) > 0):
        raise ValueError(
            "a box that is present has a pose that is not finite, or a size that is not a positive "
            "number; mask absent ones by `present`"
        )
    return poses, sizes, present


def measure_boxes(view: View, boxes: PixelBoxes, first: Int[Array, "n"]) -> Fragments:
    """Measure the shares of pixels that boxes cover, in square windows around the boxes.

    `first` is the index of the first pixel of the picture that each box is painted in.
    """
    cosine, sine = np.abs(boxes.cosine), np.abs(boxes.sine)
    along, across = boxes.half + 0.5
    reach = np.empty_like(boxes.half)
    reach[0] = cosine * along + sine * across
    reach[1] = sine * along + cosine * across
    parts = [_measure_windows(view, boxes, reach, first, *one) for one in _group(reach)]
    if len(parts) == 1:
        return parts[0]
    names = ("box", "pixel", "x", "share")
    return Fragments(
        *(np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in names)
    )


def _group(reach: Float[Array, "2 n"]) -> Iterator[tuple[Any, int]]:
    """Group boxes whose windows differ in side by a factor of two at most; also gives the sides."""
    sides = np.maximum(reach[0], reach[1])
    largest = sides.max(initial=0)
    if sides.min(initial=np.inf) >= largest / 2:
        yield slice(None), int(2 * largest) + 1
        return
    classes = np.floor(np.log2(sides))
    for number in np.unique(classes):
        some = np.flatnonzero(classes == number)
        yield some, int(2 * sides[some].max()) + 1


def _measure_windows(
    view: View,
    boxes: PixelBoxes,
    reach: Float[Array, "2 n"],
    first: Int[Array, "n"],
    some: Any,
    side: int,
) -> Fragments:
    """Measure some of the boxes in windows of one size, which are moved into the pictures."""
    cosine, sine, half = boxes.cosine[some], boxes.sine[some], boxes.half[:, some]
    height, width = min(side, view.height), min(side, view.width)
    basis, table = _make_window(height, width, view.width, half.dtype)
    middle, limit = _make_limits(view, height, width, half.dtype)
    start = middle - boxes.place[:, some]
    corner = np.ceil(start - reach[:, some])
    np.maximum(corner, 0, out=corner)
    np.minimum(corner, limit, out=corner)
    ahead, left = start - corner  # of the centre of the window's first pixel to that of the box
    matrix = np.empty((2, len(cosine), 3), half.dtype)
    matrix[0, :, 0] = matrix[1, :, 1] = cosine
    matrix[0, :, 1] = sine
    matrix[1, :, 0] = -sine
    matrix[0, :, 2] = cosine * ahead + sine * left
    matrix[1, :, 2] = cosine * left - sine * ahead
    x = (matrix.reshape(-1, 3) @ basis).reshape(2, len(cosine), len(table))
    shares = measure_overlap(x, half[..., None])
    share = (shares[0] * shares[1]).ravel()
    index = (share > 0).nonzero()[0]
    box = index // len(table)
    row, column = corner.astype(np.int64)
    start = first[some] + row * view.width + column
    pixel = start.take(box) + table.take(index - box * len(table))
    if not isinstance(some, slice):
        box = some[box]
    return Fragments(box, pixel, x.reshape(2, -1).take(index, axis=1), share.take(index))


@lru_cache(maxsize=64)
def _make_window(height: int, width: int, stride: int, dtype: Any) -> tuple[Array, Array]:
    """Make the places of a window's pixels, ahead and left of its first, and their indices."""
    row, column = np.mgrid[:height, :width].reshape(2, -1)
    return np.stack([-row, -column, np.ones_like(row)]).astype(dtype), row * stride + column


@lru_cache(maxsize=64)
def _make_limits(view: View, height: int, width: int, dtype: Any) -> tuple[Array, Array]:
    """Make the place of a view's middle from its first pixel, and that of its last window."""
    middle = np.array([[view.height - 1], [view.width - 1]], dtype) / 2
    return middle, np.array([[view.height - height], [view.width - width]], dtype)


def differentiate_shares(
    fragments: Fragments, half: Float[Array, "2 m"], grad: Float[Array, "m"]
) -> tuple[Float[Array, "2 m"], Float[Array, "2 m"]]:
    """Compute the gradients of the shares of boxes, by `x` and by `half`."""
    other = grad * measure_overlap(fragments.x, half)[::-1]
    return differentiate_overlap(fragments.x, half, other)


def differentiate_boxes(
    canvas: Canvas, boxes: PixelBoxes, fragments: Fragments, grad: Float[Array, "2 m"]
) -> tuple[Float[Array, "3 n"], Float[Array, "3 n"]]:
    """Turn gradients by places of pixels in boxes into those by poses of cameras and boxes."""
    turn = grad[0] * fragments.x[1] - grad[1] * fragments.x[0]
    along, across, turn = sum_by(fragments.box, np.array([*grad, turn]), len(boxes.view))
    ahead = across * boxes.sine - along * boxes.cosine
    left = -along * boxes.sine - across * boxes.cosine
    headings = canvas.cameras[:, 2].take(boxes.view)
    cosine, sine = (f(headings) / canvas.view.resolution for f in (np.cos, np.sin))
    poses = np.array([cosine * ahead - sine * left, sine * ahead + cosine * left, turn])
    cameras = -poses
    cameras[2] += ahead * boxes.place[1] - left * boxes.place[0]
    return cameras, poses
