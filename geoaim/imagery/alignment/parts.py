"""Alignment of imagery whose parts are displaced against each other, such as a mosaic.

The least model that the evidence needs is taken: one place for all the imagery, or else one for
each part.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt16
from numpy import ndarray as Array
from scipy.special import chdtrc

from geoaim.aim.aim import AIM
from geoaim.aim.rectification import resample
from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import transform_points, translation
from geoaim.imagery.alignment.result import ImageryAlignment

MIN_PART_SHARE = 0.02  # a part with a smaller share of the imagery is not aligned for itself
MAX_CHANCE = 1e-3  # parts differ if chance explains their places with a lower probability
# parts that differ by less, in pixels of the imagery, are placed together
MIN_DIFFERENCE_PX = 0.5
Align = Callable[[AIM], ImageryAlignment]


class Part(NamedTuple):
    """A part of imagery, and where it belongs."""

    name: str
    mask: Bool[Array, "H W"]  # its pixels
    alignment: ImageryAlignment
    placed: bool = True  # False where the other parts tell its place, since it cannot be aligned


class Labels(NamedTuple):
    """Numbers of parts, from 1, for each pixel of imagery; 0 where it shows nothing."""

    numbers: UInt16[Array, "H W"]
    names: Sequence[str]
    # where the first parts belong by what they were found by, if that is known
    found: Sequence[ImageryAlignment] = ()
    # numbers of parts, and of those found at a place that they are most likely to belong to
    beside: Mapping[int, int] = MappingProxyType({})


def align_parts(
    imagery: AIM, labels: Labels, align: Align, whole: ImageryAlignment | None, max_shift: float
) -> list[Part]:
    """Align the parts of imagery each for itself, where they need it."""
    everything = imagery.coverage > 0
    aligned, others = dict[int, Part](), []
    for number, name in enumerate(labels.names, 1):
        mask = (labels.numbers == number) & everything
        if not mask.any():
            continue
        large = mask.sum() >= MIN_PART_SHARE * everything.sum()
        found = try_alignment(align, crop_to_mask(imagery, mask))[0] if large else None
        if found is None and number <= len(labels.found):
            found = labels.found[number - 1]
        if found is None:
            others.append((number, name, mask))
        else:
            aligned[number] = Part(name, mask, found)
    parts = list(aligned.values())
    unconfirmed = bool(parts and others and labels.found)
    one_place = len(parts) < 2 or (
        whole is not None and not _differ(parts, whole, imagery.resolution)
    )
    if one_place and not unconfirmed:
        return []
    for number, name, mask in others:
        beside = aligned.get(labels.beside.get(number, 0))
        likely = None if beside is None else beside.alignment.shift
        parts.append(_place_by_others(name, mask, list(aligned.values()), max_shift, likely))
    return sorted(parts, key=lambda part: -int(part.mask.sum()))


def mask_imagery(imagery: AIM, mask: Bool[Array, "H W"]) -> AIM:
    """Keep the pixels of imagery that a mask marks."""
    return replace(imagery, coverage=np.where(mask, imagery.coverage, np.uint16(0)))


def crop_to_mask(imagery: AIM, mask: Bool[Array, "H W"]) -> AIM:
    """Keep the pixels of imagery that a mask marks, and the rectangle around these alone."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    kept = mask_imagery(imagery, mask)
    return replace(
        kept,
        image=kept.image[part],
        coverage=kept.coverage[part],
        contested=kept.contested[part],
        world_from_image=kept.world_from_image @ translation(float(columns[0]), float(rows[0])),
        report={},
    )


def compose_parts(imagery: AIM, parts: Sequence[Part]) -> AIM:
    """Move each part of imagery to its place; where parts then overlap, the largest is shown."""
    image, coverage = np.zeros_like(imagery.image), np.zeros_like(imagery.coverage)
    contested = np.zeros_like(imagery.contested)
    for part in parts:
        matrix = part.alignment.true_from_stated @ imagery.world_from_image
        moved = replace(mask_imagery(imagery, part.mask), world_from_image=matrix)
        moved = resample(moved, imagery.grid)
        shown = (moved.coverage > 0) & (coverage == 0)
        image[shown], coverage[shown] = moved.image[shown], moved.coverage[shown]
        contested[shown] = moved.contested[shown]
    return replace(imagery, image=image, coverage=coverage, contested=contested)


def try_alignment(
    align: Align, imagery: AIM
) -> tuple[ImageryAlignment | None, AlignmentError | None]:
    """Align imagery, or give the reason why it cannot be."""
    try:
        return align(imagery), None
    except AlignmentError as error:
        return None, error


def _differ(parts: Sequence[Part], whole: ImageryAlignment, resolution: float) -> bool:
    """Whether parts lie elsewhere than one place for all of them says."""
    centers = np.array([part.alignment.center for part in parts])
    expected = transform_points(whole.true_from_stated, centers)
    apart = np.array([part.alignment.center + part.alignment.shift for part in parts]) - expected
    inverse = np.linalg.inv([part.alignment.covariance for part in parts])
    squares = float(np.einsum("mi,mij,mj->", apart, inverse, apart))
    largest = np.linalg.norm(apart, axis=1).max()
    chance = chdtrc(2 * len(parts), squares)
    return bool(chance < MAX_CHANCE and largest > MIN_DIFFERENCE_PX * resolution)


def _place_by_others(
    name: str,
    mask: Bool[Array, "H W"],
    aligned: Sequence[Part],
    max_shift: float,
    likely: Float[Array, "2"] | None,
) -> Part:
    """Place a part at its likely shift, or the others' mean, as unsure as those differ from it."""
    shifts = np.array([part.alignment.shift for part in aligned])
    shift, count = shifts.mean(axis=0) if likely is None else likely, len(aligned)
    squares = ((shifts - shift) ** 2).sum() / 2 + (max_shift / 2) ** 2
    covariance = np.eye(2) * squares / count * (1 + 1 / count)
    center = np.mean([part.alignment.center for part in aligned], axis=0)
    alignment = ImageryAlignment(translation(*shift), "translation", covariance, center)
    return Part(name, mask, alignment, placed=False)
