"""Whether an alignment can be trusted: not by chance, not ambiguous, not beyond the prior."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.special import bdtrc

from geoaim.errors import AlignmentError
from geoaim.geometry import transform_points
from geoaim.imagery.alignment.candidates import (
    AGREEMENT_PX,
    MAX_RIVAL_SHARE,
    MIN_WINDOWS,
    VERIFY_SEARCH_PX,
    AlignmentCandidate,
)
from geoaim.imagery.alignment.pyramid import Level
from geoaim.imagery.alignment.result import Prior

LOG10_TESTS = 2.0  # log10 of the number of places that are refined and tested
MAX_LOG10_FALSE_ALARMS = -2.0  # log10 of the expected number of agreements by chance
PRIOR_MARGIN = 1.15  # times the prior's range, beyond which an answer is refused


def verify_candidates(candidates: list[AlignmentCandidate], level: Level, prior: Prior) -> float:
    """Refuse the best candidate if it may be chance, is ambiguous, or is beyond the prior.

    Args:
        candidates: the best first.
        level: the finest one.
        prior: how far off the imagery may be.

    Returns:
        log10 of the number of false alarms of the best candidate.

    Raises:
        AlignmentError: it is refused; the message says why.
    """
    if not candidates or candidates[0].agreeing < MIN_WINDOWS:
        raise AlignmentError(f"fewer than {MIN_WINDOWS} {_doubt_place(prior)}")
    best, corners = candidates[0], level.grid.corners
    false_alarms = _refuse_chance(best, level, prior)
    _refuse_ambiguity(candidates, level)
    _refuse_beyond_prior(best.stated_from_true, corners.mean(axis=0), prior)
    return false_alarms


def count_false_alarms(windows: float, agreeing: float) -> float:
    """log10 of the expected number of tests in which as many windows agree by chance.

    A contrario (Desolneux, Moisan and Morel 2000): windows of unrelated images are found anywhere
    in the square that is searched. Two of them always agree with a fitted similarity.
    """
    agreeing_by_chance = np.pi * AGREEMENT_PX**2 / (2 * VERIFY_SEARCH_PX + 1) ** 2
    hits = int(agreeing) - 2
    if hits <= 0:
        return LOG10_TESTS
    tail = bdtrc(hits - 1, round(windows), agreeing_by_chance)  # binomial: `hits` or more
    return LOG10_TESTS + float(np.log10(max(tail, 1e-300)))


def _refuse_chance(best: AlignmentCandidate, level: Level, prior: Prior) -> float:
    independent = best.windows / level.overlap
    false_alarms = count_false_alarms(independent, best.agreeing / level.overlap)
    if false_alarms <= MAX_LOG10_FALSE_ALARMS:
        return false_alarms
    counts = f"{best.agreeing} of {best.windows}"
    if best.agreeing > 0.8 * best.windows:
        width, height = np.ptp(level.grid.corners, axis=0)
        raise AlignmentError(
            f"{counts} windows agree, but on {width:.0f} x {height:.0f} m these are too few to be "
            "sure. More ground, or finer imagery, is needed"
        )
    raise AlignmentError(f"{counts} {_doubt_place(prior)}")


def _doubt_place(prior: Prior) -> str:
    return (
        "windows of the imagery agree with the AIM, which may be chance. Is it the same place, "
        f"within {prior.max_shift:g} m, {np.degrees(prior.max_rotation):.0f} degrees and "
        f"{100 * prior.max_scaling:.0f} % of where it says to be?"
    )


def _refuse_ambiguity(candidates: list[AlignmentCandidate], level: Level) -> None:
    best, corners = candidates[0], level.grid.corners
    moved = transform_points(best.stated_from_true, corners)
    for other in candidates[1:]:
        others = transform_points(other.stated_from_true, corners)
        distance = np.linalg.norm(others - moved, axis=1).mean()
        far = distance > 3 * AGREEMENT_PX * level.grid.resolution
        if far and other.agreeing > MAX_RIVAL_SHARE * best.agreeing:
            raise AlignmentError(
                f"the imagery fits in two ways, {distance:.1f} m apart: {best.agreeing} and "
                f"{other.agreeing} of {best.windows} windows agree. Name a smaller range, or give "
                "control points"
            )


def _refuse_beyond_prior(
    matrix: Float[Array, "3 3"], center: Float[Array, "2"], prior: Prior
) -> None:
    origin, east = transform_points(matrix, center + np.array([[0.0, 0.0], [1.0, 0.0]]))
    shift = float(np.linalg.norm(origin - center))
    rotation, scale = np.arctan2(*(east - origin)[::-1]), np.linalg.norm(east - origin)
    if (
        shift > PRIOR_MARGIN * np.sqrt(2) * prior.max_shift
        or abs(rotation) > PRIOR_MARGIN * prior.max_rotation + 0.01
        or abs(np.log(scale)) > PRIOR_MARGIN * prior.max_scaling + 0.01
    ):
        raise AlignmentError(
            f"the best place is {shift:.1f} m, {np.degrees(rotation):.1f} degrees and "
            f"{100 * (scale - 1):.1f} % off, beyond the range that was searched. Name a wider one"
        )
