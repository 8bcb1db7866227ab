"""Candidate places of imagery on an AIM: found exhaustively, refined, and compared by windows."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.geometry import make_similarity, transform_points, translation
from geoaim.grid import pad_grid
from geoaim.imagery.alignment.pyramid import Level, match_near_windows, orient_image, search_windows
from geoaim.imagery.alignment.result import Prior
from geoaim.imagery.alignment.template_matching import correlate
from geoaim.mapping.registration.motion_models import PointMatches, fit_matches

SEARCH_STEP_PX = 1.5  # of the coarsest grid, at the ends of its longer side: rotations and scales
MIN_SEPARATION_PX = 4  # of the coarsest grid, between candidates
MAX_CANDIDATES = 4  # that are refined
MAX_REFINED = 2  # that are kept after a refinement
MIN_WINDOWS = 8  # that a refinement needs
MAX_RIVAL_SHARE = 0.6  # of the best candidate's windows: a candidate with fewer is dropped
REFINE_SEARCH_PX = 6  # in which windows are found when a candidate is refined
AGREEMENT_PX = 1.5  # of the finest grid, within which a window agrees with a candidate
VERIFY_SEARCH_PX = 10  # in which windows are found when agreements are counted


class AlignmentCandidate(NamedTuple):
    """A candidate place of the imagery, and its windows.

    Attributes:
        stated_from_true: (3, 3) metres where ground lies to where the imagery places it.
        matches: of the windows that agree with the candidate.
        windows: how many could be compared.
    """

    stated_from_true: Float[Array, "3 3"]
    matches: PointMatches
    windows: int

    @property
    def agreeing(self) -> int:
        """How many windows agree with the candidate."""
        return len(self.matches.source)


def search_grid(level: Level, prior: Prior) -> list[Float[Array, "3 3"]]:
    """The best places among all rotations, scales and shifts of the prior, on a coarse grid."""
    grid = level.grid
    reach = int(np.ceil(prior.max_shift / grid.resolution))
    padded = pad_grid(grid, reach)
    center = transform_points(grid.world_from_grid, np.array([[grid.width, grid.height]]) / 2)[0]
    step = 2 * SEARCH_STEP_PX / max(grid.height, grid.width)
    scored = []
    for rotation in _list_steps(prior.max_rotation, step):
        for log_scale in _list_steps(float(np.log1p(prior.max_scaling)), step):
            similarity = make_similarity(center, rotation, float(np.exp(log_scale)))
            scores = correlate(level.reference, orient_image(level.image, similarity, padded))
            row, column = np.unravel_index(scores.argmax(), scores.shape)
            shift = translation((column - reach) * grid.resolution, (reach - row) * grid.resolution)
            scored.append((float(scores.max()), similarity @ shift))
    return _select_separate(scored, grid.corners, MIN_SEPARATION_PX * grid.resolution)


def _list_steps(end: float, step: float) -> Float[Array, "n"]:
    """Multiples of a step from about -end to about end."""
    count = int(np.ceil(end / step))
    return np.arange(-count, count + 1) * step


def _select_separate(
    scored: list[tuple[float, Float[Array, "3 3"]]], corners: Float[Array, "4 2"], metres: float
) -> list[Float[Array, "3 3"]]:
    """The best few that move the corners by more than so many metres from each other."""
    selected: list[Float[Array, "3 3"]] = []
    for _, matrix in sorted(scored, key=lambda item: -item[0]):
        moved = transform_points(matrix, corners)
        others = [transform_points(other, corners) for other in selected]
        if all(np.linalg.norm(moved - other, axis=1).mean() > metres for other in others):
            selected.append(matrix)
    return selected[:MAX_CANDIDATES]


def refine_candidates(
    level: Level, candidates: list[Float[Array, "3 3"]]
) -> list[Float[Array, "3 3"]]:
    """Refine places (stated_from_true) on a grid; those at which far fewer windows agree go."""
    grid, refined = level.grid, []
    for candidate in candidates:
        shifts = search_windows(level, candidate, REFINE_SEARCH_PX)
        matches = match_near_windows(shifts, candidate, grid, np.inf)
        if len(matches.source) >= MIN_WINDOWS:
            motion = fit_matches(matches, "similarity", size=grid.shape)
            matrix = grid.world_from_grid @ motion.matrix @ grid.grid_from_world
            agreeing = (np.linalg.norm(motion.residuals, axis=1) < AGREEMENT_PX).sum()
            refined.append((int(agreeing), matrix))
    refined.sort(key=lambda item: -item[0])
    return [
        matrix
        for agreeing, matrix in refined[:MAX_REFINED]
        if agreeing >= MAX_RIVAL_SHARE * refined[0][0]
    ]


def find_repetitions(
    level: Level, best: Float[Array, "3 3"], prior: Prior
) -> list[Float[Array, "3 3"]]:
    """Other places for the windows that agree with the best one, as on ground that repeats itself.

    Args:
        level: to search on.
        best: (3, 3) stated_from_true of the best candidate.
        prior: how far off the imagery may be.

    Returns:
        The highest correlation peaks elsewhere, as stated_from_true.
    """
    grid, shifts, half = level.grid, search_windows(level, best, REFINE_SEARCH_PX), level.side // 2
    agreeing = np.zeros(grid.shape, np.float32)
    near = np.linalg.norm(shifts.shifts, axis=1) < AGREEMENT_PX
    for u, v in shifts.centers[near].astype(int):
        agreeing[v - half : v + half, u - half : u + half] = 1
    reach = int(np.ceil(2 * prior.max_shift / grid.resolution))
    channels = orient_image(level.image, best, pad_grid(grid, reach))
    scores = correlate(level.reference * agreeing[..., None], channels)
    square = np.ones((2 * int(3 * AGREEMENT_PX) + 1,) * 2, np.uint8)
    peaks = np.argwhere(scores >= cv2.dilate(scores, square))
    peaks = peaks[np.linalg.norm(peaks - reach, axis=1) > 3 * AGREEMENT_PX]
    highest = peaks[np.argsort(-scores[tuple(peaks.T)])][:MAX_CANDIDATES]
    metres = (highest[:, ::-1] - reach) * [grid.resolution, -grid.resolution]
    return [best @ translation(x, y) for x, y in metres]


def count_agreements(level: Level, stated_from_true: Float[Array, "3 3"]) -> AlignmentCandidate:
    """Search all windows widely, and keep those that are found where the place says."""
    shifts = search_windows(level, stated_from_true, VERIFY_SEARCH_PX)
    matches = match_near_windows(shifts, stated_from_true, level.grid, AGREEMENT_PX)
    return AlignmentCandidate(stated_from_true, matches, len(shifts.centers))
