"""Alignment of imagery to an AIM of the same place.

1. Coarse: all rotations and scales of the prior, each at all shifts, on a small grid.
2. Fine: windows of the AIM are found in the imagery on ever finer grids, and a motion model is
   fitted robustly to their shifts.
3. Verification: all windows are searched once more in a wide square, and those that agree with the
   model are counted. Their number must be unlikely by chance, and no other place may have nearly
   as many.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array
from scipy.special import bdtrc

from geoaim.aim.aim import AIM
from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import make_similarity, transform_points, translation
from geoaim.base.grid import Grid, pad_grid
from geoaim.base.progress import Progress, no_progress, report_each
from geoaim.imagery.alignment.result import (
    DEFAULT_PRIOR,
    ImageryAlignment,
    Prior,
    refuse_beyond_prior,
)
from geoaim.imagery.alignment.template_matching import (
    WINDOW_PX,
    GreyImage,
    Level,
    WindowShifts,
    build_pyramid,
    compute_orientation,
    match_windows,
    resample_grey,
)
from geoaim.mapping.registration.motion_models import (
    Model,
    Motion,
    PointMatches,
    choose_model,
    compute_basis,
    fit_matches,
)

MODELS: tuple[Model, ...] = ("translation", "rigid", "similarity", "affine", "homography")
REFINEMENTS = 2  # number of refinements on the finest grid
MIN_MODEL_GAIN_PX = 0.1  # pixels of the finest grid; a richer model must gain more than this
MIN_SIGMA_PX = 0.1  # pixels of the finest grid; a sensor's own geometry is no better known
CORRELATED_WINDOWS = 3.0  # windows that shadows and changes shift together
MAX_FINE_TURNS = 1500  # rotations and scales; more are searched with half the pixels first
ROUGH_CANDIDATES = 16  # places of that search around which all turns are searched
SEARCH_STEP_PX = 1.5  # between rotations and scales, at the longer ends of the coarsest grid
MIN_SEPARATION_PX = 4  # distance between candidates, pixels of the coarsest grid
MAX_CANDIDATES = 4  # candidates that are refined
MAX_REFINED = 2  # candidates that are kept after a refinement
WIDENINGS = 4  # searches of further windows, by a homography of those that were found
MIN_WINDOWS = 8  # windows that a refinement needs
MAX_RIVAL_SHARE = 0.6  # a candidate with a smaller share of the best candidate's windows is dropped
REFINE_SEARCH_PX = 6  # search radius for windows when a candidate is refined
AGREEMENT_PX = 1.5  # a window this near agrees with a candidate, pixels of the finest grid
VERIFY_SEARCH_PX = 10  # search radius for windows when agreements are counted
LOG10_TESTS = 2.0  # log10 of the number of places that are refined and tested
MAX_LOG10_FALSE_ALARMS = -2.0  # log10 of the expected number of agreements by chance
MIN_SHARED = 0.3  # share of windows that two candidates for one part have in common


class _Candidate(NamedTuple):
    """A place of the imagery, the windows that agree with it, and how many were compared."""

    stated_from_true: Float[Array, "3 3"]
    matches: PointMatches
    windows: int

    @property
    def agreeing(self) -> int:
        """How many windows agree with the candidate."""
        return len(self.matches.source)

    def shares_windows(self, other: "_Candidate") -> bool:
        """Whether both hold for the same part of the imagery."""
        mine, others = (set(map(tuple, x.matches.source.tolist())) for x in (self, other))
        return len(mine & others) >= MIN_SHARED * len(mine)


def align_image(imagery: AIM, aim: AIM, *, prior: Prior = DEFAULT_PRIOR) -> ImageryAlignment:
    """Estimate how imagery has to be moved to lie on an AIM of the same place."""
    best, finest, false_alarms = _find_place(imagery, aim, prior)
    return _fit_alignment(best, finest, false_alarms)


def align_largest_part(imagery: AIM, aim: AIM, prior: Prior) -> ImageryAlignment:
    """Align the largest part of imagery whose parts may lie at different places."""
    return _fit_alignment(*_find_place(imagery, aim, prior, in_parts=True))


class MatchedWindows(NamedTuple):
    """Windows of a reference that were found in an image, and are inliers of one alignment."""

    in_reference: Float[Array, "M 2"]  # centres of the windows, world metres
    in_image: Float[Array, "M 2"]  # where the image shows the same ground, world metres
    residuals: Float[Array, "M 2"]  # distances from the fitted alignment, metres; y down
    information: Float[Array, "M 2 2"]  # sharpness of the peaks, along east and north


def match_image(
    image: AIM, reference: AIM, *, prior: Prior = DEFAULT_PRIOR, progress: Progress = no_progress
) -> MatchedWindows:
    """Find windows of a reference in an image of the same place, as `align_image` does.

    Args:
        image: a roughly georeferenced image.
        reference: an AIM in the same world, which the image is matched to.
        prior: how far off the image may be.
        progress: takes stage, done and total.

    Returns:
        The windows that agree with the best alignment.

    Raises:
        AlignmentError: see `align_image`.
        ValueError: they lie in different worlds.
    """
    best, finest, _ = _find_place(image, reference, prior, progress)
    grid = finest.grid
    motion = fit_matches(best.matches, "homography", size=grid.shape)
    for _ in range(WIDENINGS):
        matrix = grid.world_from_grid @ motion.matrix @ grid.grid_from_world
        wider = _count_agreements(finest, matrix)
        if wider.agreeing <= best.agreeing:
            break
        best, motion = wider, fit_matches(wider.matches, "homography", size=grid.shape)
    source, target, information = best.matches
    near = np.linalg.norm(motion.residuals, axis=1) < AGREEMENT_PX
    places = [transform_points(grid.world_from_grid, points[near]) for points in (source, target)]
    return MatchedWindows(
        places[0],
        places[1],
        motion.residuals[near] * grid.resolution,
        information[near] * [[1.0, -1.0], [-1.0, 1.0]],
    )


def _find_place(
    imagery: AIM,
    aim: AIM,
    prior: Prior,
    progress: Progress = no_progress,
    *,
    in_parts: bool = False,
) -> tuple[_Candidate, Level, float]:
    """The best candidate, the level of its windows, and log10 of its false alarms."""
    if imagery.world != aim.world:
        raise ValueError(f"the imagery lies in {imagery.world}, the AIM in {aim.world}")
    coarsest, *between, finest = build_pyramid(imagery, aim, prior)
    places = _search_grid(coarsest, prior, progress)
    levels = (*between, *[finest] * REFINEMENTS)
    for level in report_each(levels, progress, "refine", len(levels)):
        places = _refine_candidates(level, places)
    progress("verify", 0, 1)
    candidates = [_count_agreements(finest, place) for place in places]
    if candidates:
        best = max(candidates, key=lambda candidate: candidate.agreeing)
        others = _find_repetitions((between or [finest])[-1], best.stated_from_true, prior)
        candidates += [_count_agreements(finest, x) for x in _refine_candidates(finest, others)]
    candidates.sort(key=lambda candidate: -candidate.agreeing)
    if in_parts:
        candidates = [x for x in candidates if x.shares_windows(candidates[0])]
    false_alarms = _verify_candidates(candidates, finest, prior)
    progress("verify", 1, 1)
    return candidates[0], finest, false_alarms


def _search_grid(level: Level, prior: Prior, progress: Progress) -> list[Float[Array, "3 3"]]:
    """The best places among all rotations, scales and shifts of the prior, on a coarse grid."""
    grid = level.grid
    step = 2 * SEARCH_STEP_PX / max(grid.height, grid.width)
    rotations = _list_steps(prior.max_rotation, step)
    log_scales = _list_steps(float(np.log1p(prior.max_scaling)), step)
    apart = MIN_SEPARATION_PX * grid.resolution
    turns = np.stack(np.meshgrid(rotations, log_scales, indexing="ij"), axis=-1).reshape(-1, 2)
    if len(turns) > MAX_FINE_TURNS:
        rough = np.stack(np.meshgrid(rotations[::2], log_scales[::2], indexing="ij"), axis=-1)
        scored = _score_turns(level, prior, rough.reshape(-1, 2), 2, progress)
        best = _select_separate(scored, grid.corners, 2 * apart, ROUGH_CANDIDATES)
        around = np.array([_read_turn(matrix) for matrix in best])
        offset = np.abs(turns[:, None] - around[None])
        offset[..., 0] = np.minimum(offset[..., 0], 2 * np.pi - offset[..., 0])
        turns = turns[(offset < 2.1 * step).all(axis=2).any(axis=1)]
    scored = _score_turns(level, prior, turns, 1, progress)
    return _select_separate(scored, grid.corners, apart, MAX_CANDIDATES)


def _read_turn(matrix: Float[Array, "3 3"]) -> tuple[float, float]:
    """Rotation (radians) and logarithm of the scale of a similarity."""
    return float(np.arctan2(matrix[1, 0], matrix[0, 0])), float(
        np.log(np.hypot(matrix[1, 0], matrix[0, 0]))
    )


def _score_turns(
    level: Level, prior: Prior, turns: Float[Array, "n 2"], shrink: int, progress: Progress
) -> list[tuple[float, Float[Array, "3 3"]]]:
    """The best shift of each rotation and log scale, and its score, on a shrunk grid."""
    grid = level.grid
    reach = shrink * int(np.ceil(prior.max_shift / grid.resolution / shrink))
    padded = pad_grid(grid, reach)
    center = transform_points(grid.world_from_grid, np.array([[grid.width, grid.height]]) / 2)[0]
    template = _shrink_channels(level.reference, shrink)
    metres = grid.resolution * shrink
    scored = []
    for rotation, log_scale in report_each(turns.tolist(), progress, "search", len(turns)):
        similarity = make_similarity(center, rotation, float(np.exp(log_scale)))
        channels = _shrink_channels(_orient_image(level.image, similarity, padded), shrink)
        scores = cv2.matchTemplate(channels, template, cv2.TM_CCORR_NORMED)
        row, column = np.unravel_index(scores.argmax(), scores.shape)
        shift = translation(
            column * metres - reach * grid.resolution, reach * grid.resolution - row * metres
        )
        scored.append((float(scores.max()), similarity @ shift))
    return scored


def _shrink_channels(channels: Float32[Array, "H W 2"], shrink: int) -> Float32[Array, "h w 2"]:
    """Average channels over squares of pixels; what is left at the end is cut off."""
    if shrink == 1:
        return channels
    height, width = (side // shrink for side in channels.shape[:2])
    whole = channels[: height * shrink, : width * shrink]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def _list_steps(end: float, step: float) -> Float[Array, "n"]:
    """Multiples of a step from about -end to about end."""
    count = int(np.ceil(end / step))
    return np.arange(-count, count + 1) * step


def _select_separate(
    scored: list[tuple[float, Float[Array, "3 3"]]],
    corners: Float[Array, "4 2"],
    metres: float,
    count: int,
) -> list[Float[Array, "3 3"]]:
    """The best few between which the corners move by more than `metres`."""
    selected: list[Float[Array, "3 3"]] = []
    for _, matrix in sorted(scored, key=lambda item: -item[0]):
        moved = transform_points(matrix, corners)
        others = [transform_points(other, corners) for other in selected]
        if all(np.linalg.norm(moved - other, axis=1).mean() > metres for other in others):
            selected.append(matrix)
        if len(selected) == count:
            break
    return selected


def _refine_candidates(
    level: Level, candidates: list[Float[Array, "3 3"]]
) -> list[Float[Array, "3 3"]]:
    """Refine places (stated_from_true) on a grid; those at which far fewer windows agree go."""
    grid, refined = level.grid, []
    for candidate in candidates:
        shifts = _search_windows(level, candidate, REFINE_SEARCH_PX)
        matches = _match_near_windows(shifts, candidate, grid, np.inf)
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


def _find_repetitions(
    level: Level, best: Float[Array, "3 3"], prior: Prior
) -> list[Float[Array, "3 3"]]:
    """Other places (stated_from_true) where the windows that agree with the best one fit too."""
    grid, shifts, half = level.grid, _search_windows(level, best, REFINE_SEARCH_PX), level.side // 2
    agreeing = np.zeros(grid.shape, np.float32)
    near = np.linalg.norm(shifts.shifts, axis=1) < AGREEMENT_PX
    for u, v in shifts.centers[near].astype(int):
        agreeing[v - half : v + half, u - half : u + half] = 1
    reach = int(np.ceil(2 * prior.max_shift / grid.resolution))
    channels = _orient_image(level.image, best, pad_grid(grid, reach))
    template = level.reference * agreeing[..., None]
    scores = cv2.matchTemplate(channels, template, cv2.TM_CCORR_NORMED)
    square = np.ones((2 * int(3 * AGREEMENT_PX) + 1,) * 2, np.uint8)
    peaks = np.argwhere(scores >= cv2.dilate(scores, square))
    peaks = peaks[np.linalg.norm(peaks - reach, axis=1) > 3 * AGREEMENT_PX]
    highest = peaks[np.argsort(-scores[tuple(peaks.T)])][:MAX_CANDIDATES]
    metres = (highest[:, ::-1] - reach) * [grid.resolution, -grid.resolution]
    return [best @ translation(x, y) for x, y in metres]


def _count_agreements(level: Level, stated_from_true: Float[Array, "3 3"]) -> _Candidate:
    """Search all windows widely, and keep those that are found where the place says."""
    shifts = _search_windows(level, stated_from_true, VERIFY_SEARCH_PX)
    matches = _match_near_windows(shifts, stated_from_true, level.grid, AGREEMENT_PX)
    return _Candidate(stated_from_true, matches, len(shifts.centers))


def _orient_image(
    image: GreyImage, stated_from_true: Float[Array, "3 3"], grid: Grid
) -> Float32[Array, "H W 2"]:
    """Orientation channels of an image on a grid, as if it had been moved."""
    return compute_orientation(*resample_grey(image, stated_from_true, grid), grid.resolution)


def _search_windows(
    level: Level, stated_from_true: Float[Array, "3 3"], search_px: int
) -> WindowShifts:
    """Find windows of the AIM in the imagery, as if that had been moved."""
    channels = _orient_image(level.image, stated_from_true, level.grid)
    sizes = {"side": level.side, "stride": level.stride}
    return match_windows(level.reference, channels, search=search_px, **sizes)


def _match_near_windows(
    shifts: WindowShifts, stated_from_true: Float[Array, "3 3"], grid: Grid, max_shift_px: float
) -> PointMatches:
    """Windows found near their place, as pixels of the AIM and pixels where the imagery is."""
    near = np.linalg.norm(shifts.shifts, axis=1) < max_shift_px
    matrix = grid.grid_from_world @ stated_from_true @ grid.world_from_grid
    source = shifts.centers[near]
    target = transform_points(matrix, source + shifts.shifts[near])
    return PointMatches(source, target, shifts.information[near])


def _verify_candidates(candidates: list[_Candidate], level: Level, prior: Prior) -> float:
    """Refuse the best candidate (the first), or give log10 of the number of its false alarms."""
    if not candidates or candidates[0].agreeing < MIN_WINDOWS:
        raise AlignmentError(f"fewer than {MIN_WINDOWS} {_doubt_place(prior)}")
    best, corners = candidates[0], level.grid.corners
    false_alarms = _refuse_chance(best, level, prior)
    _refuse_ambiguity(candidates, level)
    refuse_beyond_prior(best.stated_from_true, corners.mean(axis=0), prior)
    return false_alarms


def compute_log_false_alarms(windows: float, agreeing: float) -> float:
    """Compute log10 of the expected number of tests in which `agreeing` or more windows agree.

    A contrario (Desolneux, Moisan and Morel 2000): windows of unrelated images are found anywhere
    in the square that is searched. Two of them always agree with a fitted similarity.
    `windows` and `agreeing` are effective numbers of independent windows, hence floats.
    """
    agreeing_by_chance = np.pi * AGREEMENT_PX**2 / (2 * VERIFY_SEARCH_PX + 1) ** 2
    hits = int(agreeing) - 2
    if hits <= 0:
        return LOG10_TESTS
    tail = bdtrc(hits - 1, round(windows), agreeing_by_chance)  # binomial: `hits` or more
    return LOG10_TESTS + float(np.log10(max(tail, 1e-300)))


def _refuse_chance(best: _Candidate, level: Level, prior: Prior) -> float:
    independent = best.windows / level.overlap
    false_alarms = compute_log_false_alarms(independent, best.agreeing / level.overlap)
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


def _refuse_ambiguity(candidates: list[_Candidate], level: Level) -> None:
    best, corners = candidates[0], level.grid.corners
    moved = transform_points(best.stated_from_true, corners)
    for other in candidates[1:]:
        others = transform_points(other.stated_from_true, corners)
        distance = np.linalg.norm(others - moved, axis=1).mean()
        far = distance > 3 * AGREEMENT_PX * level.grid.resolution
        if far and other.agreeing > MAX_RIVAL_SHARE * best.agreeing:
            raise AlignmentError(
                f"the imagery fits in two ways, {distance:.1f} m apart: {best.agreeing} and "
                f"{other.agreeing} of {best.windows} windows agree. Pass a smaller prior, or give "
                "control points"
            )


def _fit_motion(best: _Candidate, level: Level) -> Motion:
    """The simplest motion model that the windows support."""
    in_a_row = np.ptp(best.matches.source, axis=0).min() < WINDOW_PX
    model = choose_model(
        [best.matches],
        size=level.grid.shape,
        models=MODELS[:3] if in_a_row else MODELS,
        redundancy=level.overlap,
        min_gain=MIN_MODEL_GAIN_PX,
    ).model
    return fit_matches(best.matches, model, size=level.grid.shape)


def _fit_alignment(best: _Candidate, level: Level, false_alarms: float) -> ImageryAlignment:
    """The alignment by the windows' motion, with its covariance."""
    grid, motion = level.grid, _fit_motion(best, level)
    stated_from_true = grid.world_from_grid @ motion.matrix @ grid.grid_from_world
    centers = transform_points(grid.world_from_grid, best.matches.source)
    variance = _average_covariance(motion, grid.shape) * CORRELATED_WINDOWS * level.overlap
    return ImageryAlignment(
        true_from_stated=np.linalg.inv(stated_from_true),
        model=motion.model,
        covariance=(variance + MIN_SIGMA_PX**2 * np.eye(2)) * grid.resolution**2,
        center=grid.corners.mean(axis=0),
        evidence={
            "windows": best.windows,
            "windows_agreeing": best.agreeing,
            "log10_false_alarms": false_alarms,
        },
        windows=np.hstack([centers, motion.residuals * [grid.resolution, -grid.resolution]]),
        window_side=level.side * grid.resolution,
    )


def _average_covariance(motion: Motion, size: tuple[int, int]) -> Float[Array, "2 2"]:
    """Covariance of a point in square pixels, averaged over the image, y up."""
    grid = np.stack(np.meshgrid(np.linspace(0, size[1], 7), np.linspace(0, size[0], 7)), -1)
    columns = compute_basis(grid.reshape(-1, 2), motion.model, size=size) * [[1.0], [-1.0]]
    return np.einsum("mik,kl,mjl->ij", columns, motion.covariance, columns) / len(columns)
