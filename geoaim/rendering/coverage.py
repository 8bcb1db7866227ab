"""Shares of pixels that boxes and their triangles cover, and the gradients of these shares.

A share is the overlap of a box with a square of a pixel's size that is turned as the box is: a
product of two clamps. That is exact for boxes along the view's axes; turned ones keep their area.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

TRIANGLE_SHARE = 0.35  # share of a box's length that the triangle at its front takes
BASE = 1 - 2 * TRIANGLE_SHARE  # place of its base, in halves of the length from the middle


def measure_overlap(x: Float[Array, "..."], half: Float[Array, "..."]) -> Float[Array, "..."]:
    """Measure how much of a pixel at `x` lies within `half` of 0, in one dimension.

    >>> measure_overlap(np.array([0.0, 2.0, 2.25, 9.0]), np.array(2.0)).tolist()
    [1.0, 0.5, 0.25, 0.0]
    """
    shares = np.abs(x)
    np.subtract(half + 0.5, shares, out=shares)
    np.minimum(shares, np.minimum(2 * half, 1), out=shares)
    return np.maximum(shares, 0, out=shares)


def differentiate_overlap(
    x: Float[Array, "*m"], half: Float[Array, "*m"], grad: Float[Array, "*m"]
) -> tuple[Float[Array, "*m"], Float[Array, "*m"]]:
    """Compute the gradients of overlaps that are not 0, by `x` and by `half`."""
    on_edge = half + 0.5 - np.abs(x) <= np.minimum(2 * half, 1)
    by_edge = grad * on_edge
    return -np.sign(x) * by_edge, np.where(on_edge | (half >= 0.5), by_edge, 2 * grad)


@dataclass(frozen=True, eq=False)
class Tips:
    """The triangles at m pixels: how far each one reaches there, along and across its box."""

    share: Float[Array, "m"]
    base: Float[Array, "m"]
    low: Float[Array, "m"]  # the part of the pixel between the base and the tip
    high: Float[Array, "m"]
    half: Float[Array, "m"]  # half of the triangle's width in the middle of this part
    across: Float[Array, "m"]


def measure_triangles(x: Float[Array, "2 m"], half: Float[Array, "2 m"]) -> Tips:
    """Measure the shares of the triangles at the fronts of boxes, with what gradients need.

    x is how far the pixel's centre lies along and across the box from its middle, half that of the
    length and of the width of the box; pixels.
    """
    base = BASE * half[0]
    low, high = np.maximum(x[0] - 0.5, base), np.minimum(x[0] + 0.5, half[0])
    high = np.maximum(high, low)
    rest = half[0] - (low + high) / 2
    width = np.maximum(rest, 0) * half[1] / (half[0] - base)
    across = measure_overlap(x[1], width)
    return Tips((high - low) * across, base, low, high, width, across)


def differentiate_triangles(
    x: Float[Array, "2 m"], half: Float[Array, "2 m"], tips: Tips, grad: Float[Array, "m"]
) -> tuple[Float[Array, "2 m"], Float[Array, "2 m"]]:
    """Compute the gradients of the shares of triangles, by `x` and by `half`."""
    grad = np.where(tips.share > 0, grad, 0)
    by_across, by_width = differentiate_overlap(x[1], tips.half, grad * (tips.high - tips.low))
    slope = half[1] / (half[0] - tips.base)
    by_middle = -by_width * slope / 2
    by_low, by_high = by_middle - grad * tips.across, by_middle + grad * tips.across
    is_low, is_high = tips.low > tips.base, tips.high < half[0]
    by_length = by_width * slope * (1 - (1 - BASE) * tips.half / half[1])
    by_length += np.where(is_high, 0, by_high) + BASE * np.where(is_low, 0, by_low)
    by_along = np.where(is_high, by_high, 0) + np.where(is_low, by_low, 0)
    return np.stack([by_along, by_across]), np.stack([by_length, by_width * tips.half / half[1]])
