"""Comparing pictures of one ground by different sensors on different days.

Brightness changes with sensor, season and sun; where edges run does not. Each pixel gets the
direction of its edge as a doubled angle, so that dark beside bright reads as bright beside dark
does, and windows are compared by normalised correlation. Shadows do move: what is darker than its
surroundings is flattened beforehand, since a shadow is, and paint, kerbs and roofs are not.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.geometry import to_opencv
from geoaim.grid import Grid

SURROUNDINGS = 10.0  # m: what is darker than the mean this far around is flattened
SMOOTH = 0.7  # px, before edges are taken
RIM = 5  # px beside the unknown that are unknown
LEAST_KNOWN = 0.6  # of a window
FLAT = 1e-4  # curvature of a correlation's peak below which it has no place


class Shifts(NamedTuple):
    """Where windows of one picture were found in another.

    Attributes:
        middles: (M, 2) of the windows, pixels of the grid.
        shifts: (M, 2) to where they are found, pixels; NaN where at no place in particular.
        information: (M, 2, 2) how sharp the peaks are: little along a straight edge.
    """

    middles: Float[Array, "M 2"]
    shifts: Float[Array, "M 2"]
    information: Float[Array, "M 2 2"]


class Picture(NamedTuple):
    """Brightness of an image, no finer than a grid needs it, and where it is known (255)."""

    grey: Float32[Array, "H W"]
    known: UInt8[Array, "H W"]
    image_from_world: Float[Array, "3 3"]


def picture_of(aim: AIM, resolution: float) -> Picture:
    """An image as grids of so many metres a pixel need it."""
    grey: Array = cv2.cvtColor(aim.image, cv2.COLOR_RGB2GRAY)
    known: Array = np.where(aim.coverage > 0, np.uint8(255), np.uint8(0))
    matrix, step = np.linalg.inv(aim.world_from_image), resolution / aim.resolution
    if step >= 2:  # means of whole pixels first
        height, width = grey.shape
        size = round(width / int(step)), round(height / int(step))
        grey, known = (cv2.resize(x, size, interpolation=cv2.INTER_AREA) for x in (grey, known))
        matrix = np.diag([size[0] / width, size[1] / height, 1.0]) @ matrix
        step /= int(step)
    return Picture(smoothed(grey.astype(np.float32), step), known, matrix)


def smoothed(image: Array, step: float) -> Array:
    """An image for a grid whose pixels are `step` times as large."""
    if step <= 1:
        return image
    return cv2.GaussianBlur(image, (0, 0), 0.45 * np.sqrt(step**2 - 1) + 1e-3)


def grey_on(
    picture: Picture, stated_from_true: Float[Array, "3 3"], grid: Grid
) -> tuple[Float32[Array, "H W"], Bool[Array, "H W"]]:
    """Brightness on a grid, if the picture were moved, and where it is known."""
    matrix = to_opencv(picture.image_from_world @ stated_from_true @ grid.world_from_grid)
    size = grid.shape[::-1]
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    replicate = cv2.BORDER_REPLICATE
    found = cv2.warpPerspective(picture.grey, matrix, size, flags=flags, borderMode=replicate)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    share = cv2.warpPerspective(picture.known, matrix, size, flags=flags)
    return found.astype(np.float32), share > 252


def orientation(
    grey: Float32[Array, "H W"], known: Bool[Array, "H W"], resolution: float
) -> Float32[Array, "H W 2"]:
    """Doubled direction of the gradient, weighted by its strength up to the median's; 0: unknown.

    Args:
        grey: brightness.
        known: where it is.
        resolution: metres a pixel.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), SMOOTH)
    side = 2 * round(SURROUNDINGS / resolution) + 1
    around = cv2.blur(grey, (side, side))
    bright = np.maximum(smooth, around)
    x, y = (cv2.Sobel(bright, cv2.CV_32F, *axis, ksize=3) for axis in ((1, 0), (0, 1)))
    size = cv2.magnitude(x, y) + np.float32(1e-6)
    inner = cv2.erode(known.astype(np.uint8), np.ones((RIM, RIM), np.uint8), borderValue=0) > 0
    some = size[::3, ::3][inner[::3, ::3]]
    middle = np.float32(np.median(some) if len(some) else 1.0)
    weight = inner / ((size + middle) * size)
    return cv2.merge([(x * x - y * y) * weight, 2 * x * y * weight])


def seen(edges: Float32[Array, "H W 2"]) -> Bool[Array, "H W"]:
    """Where there is any edge, however weak."""
    return (edges[..., 0] != 0) | (edges[..., 1] != 0)


def correlation(
    one: Float32[Array, "h w 2"], two: Float32[Array, "H W 2"]
) -> Float32[Array, "_ _"]:
    """Normalised correlation of a picture with all places of a larger one."""
    return cv2.matchTemplate(two, one, cv2.TM_CCORR_NORMED)


def window_shifts(
    one: Float32[Array, "H W 2"],
    two: Float32[Array, "H W 2"],
    *,
    side: int,
    search: int,
    stride: int,
) -> Shifts:
    """Find windows of one picture in the other, each within `search` pixels of its place.

    Windows that are mostly unknown in either are left out. Peaks are refined by a parabola; a
    window whose best place is at the end of the search or on a ridge has NaN for its shift.
    """
    height, width = one.shape[:2]
    there = np.asarray(seen(one) & seen(two), np.float32)
    share = cv2.blur(there, (side, side), anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)
    padded = np.pad(two, ((search, search), (search, search), (0, 0)))
    reach = side + 2 * search
    corners = [
        (top, left)
        for top in range(0, height - side + 1, stride)
        for left in range(0, width - side + 1, stride)
        if share[top, left] >= LEAST_KNOWN
    ]
    scores = [
        correlation(
            one[top : top + side, left : left + side],
            padded[top : top + reach, left : left + reach],
        )
        for top, left in corners
    ]
    middles = np.array(corners, np.float64).reshape(-1, 2)[:, ::-1] + side / 2
    every = np.array(scores, np.float64).reshape(-1, 2 * search + 1, 2 * search + 1)
    places, information = _peaks(every)
    return Shifts(middles, places - search, information)


def _peaks(
    scores: Float[Array, "M h w"],
) -> tuple[Float[Array, "M 2"], Float[Array, "M 2 2"]]:
    """Where the highest scores are, and their curvature as information; NaN at border or ridge."""
    count, height, width = scores.shape
    rows, columns = np.unravel_index(
        scores.reshape(count, height * width).argmax(axis=1), (height, width)
    )
    inner = (rows > 0) & (rows < height - 1) & (columns > 0) & (columns < width - 1)
    middle = np.clip(rows, 1, height - 2), np.clip(columns, 1, width - 2)
    around = np.arange(-1, 2)
    near = scores[
        np.arange(count)[:, None, None],
        middle[0][:, None, None] + around[:, None],
        middle[1][:, None, None] + around,
    ]
    top = near[:, 1, 1]
    slope = np.stack([near[:, 1, 2] - near[:, 1, 0], near[:, 2, 1] - near[:, 0, 1]], axis=1) / 2
    mixed = (near[:, 2, 2] - near[:, 2, 0] - near[:, 0, 2] + near[:, 0, 0]) / 4
    across = near[:, 1, 0] + near[:, 1, 2] - 2 * top
    down = near[:, 0, 1] + near[:, 2, 1] - 2 * top
    bend = np.stack([across, mixed, mixed, down], axis=1).reshape(-1, 2, 2)
    inner &= np.linalg.eigvalsh(bend)[:, 1] < -FLAT
    safe = np.where(inner[:, None, None], bend, -np.eye(2))
    offset = -np.linalg.solve(safe, slope[..., None])[..., 0]
    inner &= np.abs(offset).max(axis=1) <= 1
    places = np.stack([columns, rows], axis=1) + offset
    information = -safe / (1 - np.minimum(top, 0.95))[:, None, None]
    return np.where(inner[:, None], places, np.nan), information
