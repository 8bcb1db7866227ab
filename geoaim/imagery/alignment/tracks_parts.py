"""Alignment to tracks of imagery whose parts may be displaced against each other.

Two hypotheses are weighed by their evidence (Kass and Raftery 1995): one shift for all parts, or a
shift of its own for each, as likely before as the prior of the shift says. Where neither is certain
each part's place is the mixture of both.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.special import expit, logsumexp

from geoaim.aim.aim import AIM
from geoaim.base.geometry import translation
from geoaim.imagery.alignment.by_tracks import (
    compute_moments,
    list_shifts,
    remove_undetermined_shift,
    score_parts,
)
from geoaim.imagery.alignment.parts import Labels, Part
from geoaim.imagery.alignment.result import MAX_SIGMA_M, ImageryAlignment, Prior, compute_log_prior
from geoaim.tracks.tracks import Tracks

# how probable it is before that the parts are displaced: files of their own, and within one file
FILES_DISPLACED, ONE_FILE_DISPLACED = 0.5, 0.1
MIN_DISPLACED = 0.05  # displaced parts that are less probable are not considered


class PartPlaces(NamedTuple):
    """Where tracks place parts of imagery."""

    displaced: float  # probability that the parts are displaced against each other
    parts: list[Part]


def align_parts_to_tracks(
    imagery: AIM, labels: Labels | None, tracks: Tracks, whole: ImageryAlignment, prior: Prior
) -> PartPlaces:
    """Align parts of imagery to tracks: as one, or each for itself, by the evidence."""
    masks = _list_masks(imagery, labels)
    everything = imagery.coverage > 0
    if len(masks) < 2:
        return PartPlaces(0.0, [Part("all", everything, whole)])
    rotation = -float(np.arctan2(whole.true_from_stated[1, 0], whole.true_from_stated[0, 0]))
    scores = score_parts(imagery, [mask for _, mask in masks], tracks, rotation, prior)
    displaced, weights = weigh_displacement(
        scores, prior, ONE_FILE_DISPLACED if labels is None else FILES_DISPLACED
    )
    if displaced < MIN_DISPLACED:
        return PartPlaces(displaced, [Part("all", everything, whole)])
    moments = [remove_undetermined_shift(*compute_moments(weight)) for weight in weights]
    if labels is None or displaced < 0.5:
        return PartPlaces(displaced, [Part("all", everything, _widen(whole, moments))])
    parts = [
        _place_part(name, mask, whole, one)
        for (name, mask), one in zip(masks, moments, strict=True)
    ]
    return PartPlaces(displaced, sorted(parts, key=lambda part: -int(part.mask.sum())))


def weigh_displacement(
    scores: Float[Array, "K n n"], prior: Prior, displaced: float
) -> tuple[float, Float[Array, "K n n"]]:
    """Weigh one shift for all parts against a shift of its own for each."""
    log_prior = compute_log_prior(list_shifts(scores.shape[1]), prior.max_shift)
    log_prior -= logsumexp(log_prior)
    together = scores.sum(axis=0) + log_prior
    each = scores + log_prior
    evidence = logsumexp(each, axis=(1, 2)).sum() - logsumexp(together)
    after = float(expit(np.log(displaced / (1 - displaced)) + evidence))
    own = np.exp(each - logsumexp(each, axis=(1, 2), keepdims=True))
    return after, after * own + (1 - after) * np.exp(together - logsumexp(together))


def _list_masks(imagery: AIM, labels: Labels | None) -> list[tuple[str, Bool[Array, "H W"]]]:
    """Names and pixels of the files that show anything, or of quarters."""
    shown = imagery.coverage > 0
    if labels is None:
        v, u = (np.arange(size) < size / 2 for size in shown.shape)
        quarters = [rows[:, None] & columns for rows in (v, ~v) for columns in (u, ~u)]
        return [("", quarter & shown) for quarter in quarters if (quarter & shown).any()]
    masks = [(name, (labels.numbers == k) & shown) for k, name in enumerate(labels.names, 1)]
    return [(name, mask) for name, mask in masks if mask.any()]


Moments = tuple[Float[Array, "2"], Float[Array, "2 2"]]


def _widen(whole: ImageryAlignment, moments: Sequence[Moments]) -> ImageryAlignment:
    """State the place as widely as that of the part that may be the farthest off."""
    shift = _get_shift(whole)
    wide = [covariance + np.outer(mean - shift, mean - shift) for mean, covariance in moments]
    covariance = max([whole.covariance, *wide], key=np.trace)
    return replace(whole, covariance=covariance)


def _place_part(
    name: str, mask: Bool[Array, "H W"], whole: ImageryAlignment, moments: Moments
) -> Part:
    """Move a part by its own shift; it is not aligned where that is unknown in all directions."""
    shift, covariance = moments
    stated_from_true = np.linalg.inv(whole.true_from_stated)
    own = translation(*(shift - _get_shift(whole))) @ stated_from_true
    alignment = replace(whole, true_from_stated=np.linalg.inv(own), covariance=covariance)
    return Part(name, mask, alignment, bool(np.linalg.eigvalsh(covariance)[0] < MAX_SIGMA_M**2))


def _get_shift(alignment: ImageryAlignment) -> Float[Array, "2"]:
    """How far tracks lie from where imagery states them, at the center."""
    center = alignment.center
    return (np.linalg.inv(alignment.true_from_stated) @ [*center, 1])[:2] - center


UNKNOWN_M2 = 1e8  # variance of what is not known, square metres


def weigh_alignment(
    alignment: ImageryAlignment, own: Float[Array, "2 2"], reference: Float[Array, "2 2"]
) -> tuple[ImageryAlignment, Float[Array, "2 2"]]:
    """Combine an alignment with what was known of the imagery's place before.

    The alignment says where the imagery lies relative to its reference, which may itself be off.
    In a direction in which the imagery's own place is better known it stays.

    >>> off = ImageryAlignment(translation(5.0, 5.0), "translation", np.eye(2) * 0.01, np.zeros(2))
    >>> moved, _ = weigh_alignment(off, np.eye(2) * 100, np.diag([0.0, 1e6]))
    >>> moved.shift.round(1).tolist()  # of north the reference says nothing
    [5.0, 0.0]
    """
    gain = own @ np.linalg.inv(own + reference + alignment.covariance)
    remaining = np.eye(2) - gain
    back = -remaining @ alignment.shift
    covariance = remaining @ own
    moved = replace(alignment, true_from_stated=translation(*back) @ alignment.true_from_stated)
    return moved, (covariance + covariance.T) / 2


def forget_undetermined(alignment: ImageryAlignment) -> ImageryAlignment:
    """State that nothing is known along the undetermined direction of an alignment."""
    direction = alignment.undetermined_direction
    if direction is None:
        return alignment
    along = np.array([np.cos(direction), np.sin(direction)])
    return replace(alignment, covariance=alignment.covariance + np.outer(along, along) * UNKNOWN_M2)
