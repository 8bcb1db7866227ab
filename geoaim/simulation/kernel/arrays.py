"""Arguments and results of the compiled loops: named tuples of arrays."""

from typing import NamedTuple

from numpy import ndarray as Array


class Views(NamedTuple):
    """V views of B scenes, V / B of each in turn."""

    cameras: Array  # (V, 3) x and y, metres, and heading, radians
    present: Array  # (V,) which views exist; the others are 0 everywhere; empty: all exist
    scenes: int  # B
    resolution: float  # metres per pixel


class Textures(NamedTuple):
    """The textures of one map, or of one map for each scene, in one image."""

    image: Array  # (h, w, C)
    image_from_world: Array  # (1 or B, 2, 3) metres to pixels (corner origin)
    regions: Array  # (1 or B, 4) left, top, right and bottom edge of each map in the image


class Boxes(NamedTuple):
    """N boxes in each of B scenes, in paint order; what all scenes share is given once."""

    poses: Array  # (B, N, 3) x and y, metres, and heading, radians
    sizes: Array  # (1 or B, N, 2) length and width, metres
    colours: Array  # (1 or B, N, K)
    triangle_colours: Array  # (1 or B, N, K)
    present: Array  # (B, N), or empty: all are present
    # (L, 3) for each layer: the number of its boxes, whether they have triangles, and the first of
    # the picture's channels that they are painted in
    layers: Array


class PaintedFragments(NamedTuple):
    """What boxes contribute to the pixels of views, in paint order."""

    # (V + 1,) index of the first fragment of each view, and the number of all fragments
    starts: Array
    # (n, 5) numbers of the box and of its layer, row, column, and flags of the edges in the pixel;
    # or the first column of several pixels that the box covers, and minus the one after the last
    places: Array
    shares: Array  # (n, 2) shares of the pixel that the box and its triangle cover
    below: Array  # (n, K) what is painted over


class Gradients(NamedTuple):
    """Gradients of the loss; the image's is summed over views, the others are one for each view."""

    # (V, C, H, W) gradients with respect to the pictures: an input, the others are results
    pictures: Array
    cameras: Array  # (V, 3)
    image_from_world: Array  # (V, 2, 3); (0, 2, 3): not needed
    image: Array  # (h, w, C); (0, w, C): not needed
    poses: Array  # (V, N, 3)
    sizes: Array  # (V, N, 2)
    colours: Array  # (V, N, K)
    triangle_colours: Array  # (V, N, K)
