"""Parts of one image that lie at different places of an AIM, such as those of a mosaic in one file.

What does not agree with the first place is aligned once more. Each pixel then belongs to the place
by which its edges are most similar to those of the AIM around it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt16
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.rectification import sample_nearest
from geoaim.base.geometry import transform_points
from geoaim.base.grid import Grid
from geoaim.imagery.alignment.by_image import align_largest_part
from geoaim.imagery.alignment.parts import MIN_PART_SHARE, Labels, crop_to_mask, try_alignment
from geoaim.imagery.alignment.result import ImageryAlignment, Prior
from geoaim.imagery.alignment.template_matching import (
    compute_orientation,
    reduce_to_grey,
    resample_grey,
)

MAX_SEGMENTS = 8  # parts that are looked for within one file
SPLITS = 2  # times that the imagery is halved each way, for parts that are small within the whole
# of the ground: a region of a larger share where nothing agrees with the only place is set apart
MIN_UNCONFIRMED_SHARE = 0.15
MAX_SAME_PX = 0.75  # places that differ by less, in pixels of the imagery, are one
MAX_SEGMENT_PX = 2048  # longer side of the grid on which pixels are divided into parts
# the windows of parts must lie together: this share of them within the part's own pixels
MIN_TOGETHER = 0.85


def find_parts(imagery: AIM, aim: AIM, prior: Prior) -> Labels | None:
    """Find parts of one image that lie at different places of an AIM."""
    found, unexplained = list[ImageryAlignment](), imagery.coverage > 0
    for depth in range(SPLITS + 1):
        for box in _mark_rectangles(imagery, 2**depth):
            found += _find_places(imagery, aim, prior, unexplained, box)
    places = _merge_places(found, imagery.resolution)
    labels = _divide_pixels(imagery, aim, places)
    if labels is None:
        return _separate_unconfirmed(imagery, aim, places[:1])
    refined, unexplained = _align_again(imagery, aim, prior, labels), imagery.coverage > 0
    for alignment in refined:
        unexplained &= ~_mark_windows(imagery, alignment)
    refined += _find_places(imagery, aim, prior, unexplained, unexplained)
    return _divide_pixels(imagery, aim, _merge_places(refined, imagery.resolution)) or labels


def _separate_unconfirmed(
    imagery: AIM, aim: AIM, places: Sequence[ImageryAlignment]
) -> Labels | None:
    """Make parts of large regions where nothing agrees with the only place that was found."""
    if not places:
        return None
    matrix = aim.grid.grid_from_world @ imagery.world_from_image
    ground = sample_nearest(aim.coverage, matrix, imagery.coverage.shape) > 0
    ground &= imagery.coverage > 0
    side = np.sqrt(MIN_PART_SHARE * ground.size)
    rest = _find_large(ground & ~_mark_windows(imagery, places[0]), side)
    numbers = np.ones(ground.shape, np.uint16)
    names = ["part 1"]
    for number in range(1, int(rest.max()) + 1):
        if (rest == number).sum() > MIN_UNCONFIRMED_SHARE * ground.sum():
            names.append(f"part {len(names) + 1}")
            numbers[rest == number] = len(names)
    return (
        Labels(numbers, names, places, dict.fromkeys(range(2, len(names) + 1), 1))
        if len(names) > 1
        else None
    )


def _align_again(imagery: AIM, aim: AIM, prior: Prior, labels: Labels) -> list[ImageryAlignment]:
    """Align each part by its own pixels: those of others may have bent its first place."""
    refined = []
    for number, alignment in enumerate(labels.found, 1):
        part = crop_to_mask(imagery, (labels.numbers == number) & (imagery.coverage > 0))
        again, _ = try_alignment(lambda x: align_largest_part(x, aim, prior), part)
        refined.append(again or alignment)
    return refined


def _mark_rectangles(imagery: AIM, count: int) -> Iterator[Bool[Array, "H W"]]:
    """Mark the pixels of each of `count` x `count` rectangles."""
    height, width = imagery.coverage.shape
    rows, columns = (np.linspace(0, size, count + 1).astype(int) for size in (height, width))
    for top, bottom in pairwise(rows):
        for left, right in pairwise(columns):
            box = np.zeros((height, width), bool)
            box[top:bottom, left:right] = True
            yield box


def _find_places(
    imagery: AIM, aim: AIM, prior: Prior, unexplained: Bool[Array, "H W"], box: Bool[Array, "H W"]
) -> list[ImageryAlignment]:
    """Find the places of what a rectangle shows and no place explains, and mark it explained."""
    found = list[ImageryAlignment]()
    while (unexplained & box).sum() >= MIN_PART_SHARE * (imagery.coverage > 0).sum():
        rest = crop_to_mask(imagery, unexplained & box)
        place, _ = try_alignment(lambda x: align_largest_part(x, aim, prior), rest)
        if place is None:
            break
        found.append(place)
        unexplained &= ~_mark_windows(imagery, place)
    return found


def _merge_places(found: Sequence[ImageryAlignment], resolution: float) -> list[ImageryAlignment]:
    """Keep one of those that say the same, with the windows of all; the most windows first."""
    kept = list[ImageryAlignment]()
    for one in sorted(found, key=lambda one: -one.evidence["windows_agreeing"]):
        same = [k for k, other in enumerate(kept) if _say_the_same(one, other, resolution)]
        if same:
            windows = np.concatenate([kept[same[0]].windows, one.windows])
            kept[same[0]] = replace(kept[same[0]], windows=windows)
        else:
            kept.append(one)
    return kept[:MAX_SEGMENTS]


def _say_the_same(one: ImageryAlignment, other: ImageryAlignment, resolution: float) -> bool:
    """Whether two alignments move the ground of the first equally far."""
    moved = transform_points(other.true_from_stated, one.center[None])[0] - one.center
    return bool(np.linalg.norm(moved - one.shift) < MAX_SAME_PX * resolution)


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
    if len(found) < 2:
        return None
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
    agreeing = np.zeros((height, width), bool)
    for number, index in enumerate(kept, 1):
        agreeing |= _mark_windows(imagery, found[index]) & (numbers == number)
    names = [f"part {number}" for number in range(1, len(kept) + 1)]
    side = found[0].window_side / imagery.resolution  # a window fits in, and none agrees
    rest = _find_large((imagery.coverage > 0) & ~agreeing, side)
    beside = dict[int, int]()
    for number in range(1, int(rest.max()) + 1):
        region = rest == number
        names.append(f"part {len(names) + 1}")
        beside[len(names)] = int(np.bincount(numbers[region]).argmax())
        numbers[region] = len(names)
    return Labels(numbers, names, [found[index] for index in kept], beside)


def _find_large(mask: Bool[Array, "H W"], side: float) -> UInt16[Array, "H W"]:
    """Number the connected regions of a mask that hold a square of so many pixels, from 1."""
    square = np.ones((max(int(side), 1),) * 2, np.uint8)
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, square)
    return cv2.connectedComponents(opened, ltype=cv2.CV_16U)[1]


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
