"""Parts of one image that lie at different places of an AIM, such as those of a mosaic in one file.

What does not agree with the first place is aligned once more. Each pixel then belongs to the place
by which its edges are most similar to those of the AIM around it.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.geometry import transform_points
from geoaim.base.grid import Grid
from geoaim.imagery.alignment.by_image import align_largest_part
from geoaim.imagery.alignment.parts import Labels, mask_imagery, try_alignment
from geoaim.imagery.alignment.prior import Prior
from geoaim.imagery.alignment.result import ImageryAlignment
from geoaim.imagery.alignment.template_matching import (
    compute_orientation,
    reduce_to_grey,
    resample_grey,
)

MAX_SEGMENTS = 8  # parts that are looked for within one file
MAX_SEGMENT_PX = 2048  # longer side of the grid on which pixels are divided into parts
# the windows of parts must lie together: this share of them within the part's own pixels
MIN_TOGETHER = 0.85


def find_parts(imagery: AIM, aim: AIM, prior: Prior) -> Labels | None:
    """Find parts of one image that lie at different places of an AIM.

    Args:
        imagery: roughly georeferenced imagery.
        aim: an AIM in the same world.
        prior: how far off each part may be.

    Returns:
        The parts; None where there is one only, or where what differs does not lie together, as
        roofs that lean.
    """
    rest, found = imagery, list[ImageryAlignment]()
    while len(found) < MAX_SEGMENTS and rest.coverage.any():
        alignment, _ = try_alignment(lambda x: align_largest_part(x, aim, prior), rest)
        if alignment is None:
            break
        found.append(alignment)
        rest = mask_imagery(rest, ~_mark_windows(imagery, alignment))
    return _divide_pixels(imagery, aim, found) if len(found) > 1 else None


def _list_windows(imagery: AIM, alignment: ImageryAlignment) -> Float[Array, "M 2"]:
    """Pixels of the imagery in the middle of the windows that agree with an alignment."""
    assert alignment.windows is not None
    stated_from_true = np.linalg.inv(alignment.true_from_stated)
    matrix = imagery.grid.grid_from_world @ stated_from_true
    return transform_points(matrix, alignment.windows[:, :2])


def _mark_windows(imagery: AIM, alignment: ImageryAlignment) -> Bool[Array, "H W"]:
    """Mark the windows that agree with an alignment in imagery."""
    marked = np.zeros(imagery.coverage.shape, bool)
    half = alignment.window_side / 2 / imagery.resolution
    for pixel in _list_windows(imagery, alignment):
        left, top = np.rint(pixel - half).clip(0).astype(int)
        right, bottom = np.rint(pixel + half).clip(0).astype(int)
        marked[top:bottom, left:right] = True
    return marked


def _divide_pixels(imagery: AIM, aim: AIM, found: Sequence[ImageryAlignment]) -> Labels | None:
    """Give each pixel to the part by whose place it is most similar to the AIM around it."""
    height, width = imagery.coverage.shape
    coarsest = max(height, width) / MAX_SEGMENT_PX
    step = max(aim.resolution / imagery.resolution, coarsest, 1.0)
    matrix = imagery.world_from_image @ np.diag([step, step, 1.0])
    grid = Grid((int(np.ceil(height / step)), int(np.ceil(width / step))), matrix, imagery.world)
    similar = np.stack([_measure_similarity(imagery, aim, one, grid) for one in found])
    best = similar.argmax(axis=0)
    kept = []
    for number, alignment in enumerate(found):
        pixels = (_list_windows(imagery, alignment) / step).astype(int)
        u, v = np.clip(pixels, 0, [grid.width - 1, grid.height - 1]).T
        if (best[v, u] == number).mean() >= MIN_TOGETHER:
            kept.append(number)
    if len(kept) < 2:
        return None
    coarse = (similar[kept].argmax(axis=0) + 1).astype(np.uint16)
    numbers = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_NEAREST)
    return Labels(numbers, [f"part {number}" for number in range(1, len(kept) + 1)])


def _measure_similarity(
    imagery: AIM, aim: AIM, alignment: ImageryAlignment, grid: Grid
) -> Float32[Array, "h w"]:
    """How similar the edges of imagery around each pixel are to those of an AIM, once moved."""
    channels = [
        compute_orientation(
            *resample_grey(reduce_to_grey(picture, grid.resolution), matrix, grid), grid.resolution
        )
        for picture, matrix in ((imagery, np.eye(3)), (aim, alignment.true_from_stated))
    ]
    products = (channels[0] * channels[1]).sum(axis=2)
    sigma = alignment.window_side / 4 / grid.resolution
    return cv2.GaussianBlur(products, (0, 0), sigma).astype(np.float32)
