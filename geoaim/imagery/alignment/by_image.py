"""Where imagery of others truly lies, by an AIM of the same place.

Coarse: all turns and zooms of the prior's range, each at all shifts, on a small grid. Fine: windows
of the imagery are looked for on ever finer grids, and the least motion model that they support is
fitted robustly. Last: windows are looked for once more in a wide circle, and are counted that are
found where the model says. So many would not be found there by chance, and no other
candidate may do nearly as well.
"""

from math import comb, log10
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.errors import AlignmentError
from geoaim.geometry import similarity_about, transform_points, translation
from geoaim.grid import Grid, north_up_grid, pad_grid
from geoaim.imagery.alignment.result import PRIOR, Alignment, Prior
from geoaim.imagery.alignment.template_matching import (
    Picture,
    Shifts,
    correlation,
    grey_on,
    orientation,
    picture_of,
    seen,
    window_shifts,
)
from geoaim.mapping.registration.motion_models import (
    Model,
    Motion,
    PointMatches,
    choose_model,
    compute_basis,
    fit_matches,
)

ALIGNED: tuple[Model, ...] = ("translation", "rigid", "similarity", "affine", "homography")

SIDE = 64  # px of a window
COARSE = 128  # px of the longer side of the coarsest grid
NARROWEST = 32  # px of its shorter side
FINE = 0.8  # of the coarser picture's pixel: the finest grid
MOST = 300  # windows on one grid, or so
FEWEST = 8  # windows that must be comparable
CANDIDATES = 4  # places that are followed from the coarsest grid
KEPT = 2  # and from the next one on
RIVAL = 0.6  # of the best candidate's windows that another may not reach
STEP = 1.5  # px of the coarsest grid between turns and zooms, at the ends of the longer side
ROUNDS = 2  # of mending on the finest grid
NARROW = 6  # px in which windows are looked for on finer grids
MATERIAL = 0.1  # px of the finest grid: a smaller gain is not worth a richer model
FLOOR = 0.1  # px of the finest grid: a sensor's own geometry is no better known
COHERENT = 3.0  # windows that shadows and changes move alike
TRIED = 2.0  # log10 of the places that are followed and mended
AGREE = 1.5  # px of the finest grid within which a window is where it should be
WIDE = 10  # px in which windows are looked for at last
CHANCE = -2.0  # log10 of the number of such agreements by chance that is too many
EDGE = 1.15  # times the prior's range at which an answer is out of it


class Candidate(NamedTuple):
    """A place of the picture, stated from true, and its windows.

    Attributes:
        place: (3, 3) metres where it lies -> where it says to lie.
        match: of the windows that are found where the place says.
        windows: how many could be compared.
    """

    place: Float[Array, "3 3"]
    match: PointMatches
    windows: int

    @property
    def agreeing(self) -> int:
        """How many windows are found where the place says."""
        return len(self.match.source)


class Level(NamedTuple):
    """A grid, the edges of the ground on it, and the picture that is laid on these."""

    grid: Grid
    ground: Float32[Array, "H W 2"]
    picture: Picture


def align_image(imagery: AIM, aim: AIM, *, prior: Prior = PRIOR) -> Alignment:
    """Find how imagery has to be moved to lie on an AIM of the same place.

    Args:
        imagery: where it says to lie; of any sensor, day and resolution.
        aim: where the ground truly lies, in the same world.
        prior: how far off the imagery may be.

    Raises:
        AlignmentError: both hardly overlap, have too little in common, or fit in two ways.
        ValueError: they lie in different worlds.
    """
    if imagery.world != aim.world:
        raise ValueError(f"the imagery lies in {imagery.world}, the AIM in {aim.world}")
    first, *between, last = [_level(imagery, aim, grid) for grid in _grids(imagery, aim, prior)]
    places = _coarse(first, prior)
    for level in (*between, *[last] * ROUNDS):
        places = _followed(level, places)
    found = [_judged(last, place) for place in places]
    if found:
        best = max(found, key=lambda candidate: candidate.agreeing)
        rivals = _rivals((between or [last])[-1], best.place, prior)
        found += [_judged(last, place) for place in _followed(last, rivals)]
    found.sort(key=lambda candidate: -candidate.agreeing)
    corners = last.grid.corners
    chance = _refuse(found, last, corners, prior)
    return _least(found[0], last, corners.mean(axis=0), chance)


def _grids(imagery: AIM, aim: AIM, prior: Prior) -> list[Grid]:
    """Grids over what both show, from coarse to fine."""
    low = np.maximum(aim.corners.min(axis=0), imagery.corners.min(axis=0) - prior.reach)
    high = np.minimum(aim.corners.max(axis=0), imagery.corners.max(axis=0) + prior.reach)
    finest = FINE * max(imagery.resolution, aim.resolution)
    shorter, longer = np.sort(high - low) / finest
    if shorter < 2 * SIDE:
        raise AlignmentError(
            f"the imagery lies {_extent(imagery)}, the AIM {_extent(aim)}; with {prior.reach:g} m "
            f"to search, both must share {2 * SIDE * finest:.0f} m each way or more"
        )
    halvings = min(np.ceil(np.log2(longer / COARSE)), np.floor(np.log2(shorter / NARROWEST)))
    corners = np.stack([low, high])
    steps = range(max(int(halvings), 1), -1, -1)
    return [north_up_grid(corners, finest * 2**k, aim.world) for k in steps]


def _level(imagery: AIM, aim: AIM, grid: Grid) -> Level:
    ground = _edges(picture_of(aim, grid.resolution), np.eye(3), grid)
    return Level(grid, ground, picture_of(imagery, grid.resolution))


def _edges(
    picture: Picture, stated_from_true: Float[Array, "3 3"], grid: Grid
) -> Float32[Array, "H W 2"]:
    """Directions of an image's edges on a grid, if it were moved."""
    return orientation(*grey_on(picture, stated_from_true, grid), grid.resolution)


def _coarse(level: Level, prior: Prior) -> list[Float[Array, "3 3"]]:
    """The best places of the prior's range that are not beside a better one, stated from true."""
    grid = level.grid
    metres, reach = grid.resolution, int(np.ceil(prior.reach / grid.resolution))
    wider = pad_grid(grid, reach)
    middle = transform_points(grid.world_from_grid, np.array([[grid.width, grid.height]]) / 2)[0]
    step = 2 * STEP / max(grid.height, grid.width)
    found = []
    for turn in _range(prior.turn, step):
        for zoom in _range(float(np.log1p(prior.zoom)), step):
            moved = similarity_about(middle, turn, float(np.exp(zoom)))
            scores = correlation(level.ground, _edges(level.picture, moved, wider))
            row, column = np.unravel_index(scores.argmax(), scores.shape)
            shift = translation((column - reach) * metres, (reach - row) * metres)
            found.append((float(scores.max()), moved @ shift))
    return _apart(found, grid.corners, 4 * metres)


def _apart(
    found: list[tuple[float, Float[Array, "3 3"]]], corners: Float[Array, "4 2"], metres: float
) -> list[Float[Array, "3 3"]]:
    """The best few that move the corners differently by so many metres."""
    kept: list[Float[Array, "3 3"]] = []
    for _, matrix in sorted(found, key=lambda one: -one[0]):
        moved = transform_points(matrix, corners)
        others = [transform_points(other, corners) for other in kept]
        if all(np.linalg.norm(moved - other, axis=1).mean() > metres for other in others):
            kept.append(matrix)
    return kept[:CANDIDATES]


def _followed(level: Level, places: list[Float[Array, "3 3"]]) -> list[Float[Array, "3 3"]]:
    """Places mended on a grid, without those at which far fewer windows agree."""
    grid, mended = level.grid, []
    for place in places:
        match = _match(_compare(level, place, NARROW), place, grid, np.inf)
        if len(match.source) >= FEWEST:
            motion = fit_matches(match, "similarity", size=grid.shape)
            matrix = grid.world_from_grid @ motion.matrix @ np.linalg.inv(grid.world_from_grid)
            agreeing = (np.linalg.norm(motion.residuals, axis=1) < AGREE).sum()
            mended.append((int(agreeing), matrix))
    mended.sort(key=lambda one: -one[0])
    return [matrix for agreeing, matrix in mended[:KEPT] if agreeing >= RIVAL * mended[0][0]]


def _compare(level: Level, place: Float[Array, "3 3"], search: int) -> Shifts:
    """Windows of the ground, looked for in the picture as moved."""
    edges = _edges(level.picture, place, level.grid)
    sizes = {"side": _side(level), "stride": _stride(level)}
    return window_shifts(level.ground, edges, search=search, **sizes)


def _side(level: Level) -> int:
    """Pixels of a window: half as many where few would fit."""
    return SIDE if min(level.grid.shape) >= 4 * SIDE else SIDE // 2


def _stride(level: Level) -> int:
    """Pixels between windows, of which some `MOST` or fewer lie on known ground."""
    known = np.count_nonzero(seen(level.ground))
    return max(int(np.sqrt(known / MOST)), _side(level) // 4)


def _match(shifts: Shifts, matrix: Float[Array, "3 3"], grid: Grid, reach: float) -> PointMatches:
    """Pixels where the ground is, and where the imagery says to show it; of the near ones."""
    near = np.linalg.norm(shifts.shifts, axis=1) < reach
    total = np.linalg.inv(grid.world_from_grid) @ matrix @ grid.world_from_grid
    source = shifts.middles[near]
    target = transform_points(total, source + shifts.shifts[near])
    return PointMatches(source, target, shifts.information[near])


def _rivals(level: Level, best: Float[Array, "3 3"], prior: Prior) -> list[Float[Array, "3 3"]]:
    """Other places of what agrees at the best one: where ground repeats itself, it fits there."""
    grid, shifts, half = level.grid, _compare(level, best, NARROW), _side(level) // 2
    there = np.zeros(level.ground.shape[:2], np.float32)
    for u, v in shifts.middles[np.linalg.norm(shifts.shifts, axis=1) < AGREE].astype(int):
        there[v - half : v + half, u - half : u + half] = 1
    reach = int(np.ceil(2 * prior.reach / grid.resolution))
    edges = _edges(level.picture, best, pad_grid(grid, reach))
    scores = correlation(level.ground * there[..., None], edges)
    around = np.ones((2 * int(3 * AGREE) + 1,) * 2, np.uint8)
    peaks = np.argwhere(scores >= cv2.dilate(scores, around))
    peaks = peaks[np.linalg.norm(peaks - reach, axis=1) > 3 * AGREE]
    highest = peaks[np.argsort(-scores[tuple(peaks.T)])][:CANDIDATES]
    metres = (highest[:, ::-1] - reach) * [grid.resolution, -grid.resolution]
    return [best @ translation(x, y) for x, y in metres]


def _judged(level: Level, place: Float[Array, "3 3"]) -> Candidate:
    shifts = _compare(level, place, WIDE)
    return Candidate(place, _match(shifts, place, level.grid, AGREE), len(shifts.middles))


def _least(best: Candidate, level: Level, middle: Float[Array, "2"], chance: float) -> Alignment:
    """The least model that the windows support, and how well it is known."""
    grid, size = level.grid, level.grid.shape
    in_a_row = np.ptp(best.match.source, axis=0).min() < SIDE
    model = choose_model(
        [best.match],
        size=size,
        models=ALIGNED[:3] if in_a_row else ALIGNED,
        redundancy=_overlap(level),
        min_gain=MATERIAL,
    ).model
    motion = fit_matches(best.match, model, size=size)
    stated_from_true = grid.world_from_grid @ motion.matrix @ np.linalg.inv(grid.world_from_grid)
    variance = _covariance(motion, size) * COHERENT * _overlap(level) + FLOOR**2 * np.eye(2)
    return Alignment(
        true_from_stated=np.linalg.inv(stated_from_true),
        model=model,
        covariance=variance * grid.resolution**2,
        middle=middle,
        evidence={"windows": best.windows, "agreeing": best.agreeing, "log10_chance": chance},
    )


def _overlap(level: Level) -> float:
    """How many windows cover a pixel, at least one."""
    return max((_side(level) / _stride(level)) ** 2, 1.0)


def _covariance(motion: Motion, size: tuple[int, int]) -> Float[Array, "2 2"]:
    """Of a place, square pixels, averaged over the picture; v down becomes y up."""
    height, width = size
    grid = np.stack(np.meshgrid(np.linspace(0, width, 7), np.linspace(0, height, 7)), -1)
    columns = compute_basis(grid.reshape(-1, 2), motion.model, size=size) * [[1.0], [-1.0]]
    return np.einsum("mik,kl,mjl->ij", columns, motion.covariance, columns) / len(columns)


def _chance(windows: float, agreeing: float) -> float:
    """log10 of how often so many windows agree by chance, in all places that were followed.

    A contrario (Desolneux, Moisan and Morel 2000): windows of unrelated pictures are found
    anywhere in the circle that is searched. Two of them are what a similarity fits by itself.
    """
    trials, hits = round(windows), int(agreeing) - 2
    share = np.pi * AGREE**2 / (2 * WIDE + 1) ** 2
    if hits <= 0:
        return TRIED
    tail = sum(
        comb(trials, k) * share**k * (1 - share) ** (trials - k) for k in range(hits, trials + 1)
    )
    return TRIED + log10(max(tail, 1e-300))


def _refuse(
    found: list[Candidate], level: Level, corners: Float[Array, "4 2"], prior: Prior
) -> float:
    """Refuse what may be chance, what fits in two ways, and what is at the end of the range."""
    if not found or found[0].agreeing < FEWEST:
        raise AlignmentError(f"fewer than {FEWEST} {_doubt(prior)}")
    best, overlap = found[0], _overlap(level)
    said = f"{best.agreeing} of {best.windows}"
    chance = _chance(best.windows / overlap, best.agreeing / overlap)
    if chance > CHANCE and best.agreeing > 0.8 * best.windows:
        wide, high = np.ptp(corners, axis=0)
        raise AlignmentError(
            f"{said} windows agree, but on {wide:.0f} x {high:.0f} m these are too few to be sure. "
            "More ground, or finer imagery, is needed"
        )
    if chance > CHANCE:
        raise AlignmentError(f"{said} {_doubt(prior)}")
    here = transform_points(best.place, corners)
    for other in found[1:]:
        apart = np.linalg.norm(transform_points(other.place, corners) - here, axis=1).mean()
        far = apart > 3 * AGREE * level.grid.resolution
        if far and other.agreeing > RIVAL * best.agreeing:
            raise AlignmentError(
                f"the imagery fits in two ways, {apart:.1f} m apart: {best.agreeing} and "
                f"{other.agreeing} of {best.windows} windows agree. Name a smaller range, or give "
                "control points"
            )
    _refuse_far(best.place, corners.mean(axis=0), prior)
    return chance


def _doubt(prior: Prior) -> str:
    return (
        "windows of the imagery are where they should be on the AIM, which may be chance. Is it "
        f"the same place, within {prior.reach:g} m, {np.degrees(prior.turn):.0f} degrees and "
        f"{100 * prior.zoom:.0f} % of where it says to be?"
    )


def _refuse_far(matrix: Float[Array, "3 3"], middle: Float[Array, "2"], prior: Prior) -> None:
    origin, east = transform_points(matrix, middle + np.array([[0.0, 0.0], [1.0, 0.0]]))
    shift = float(np.linalg.norm(origin - middle))
    turn, zoom = np.arctan2(*(east - origin)[::-1]), np.linalg.norm(east - origin)
    if (
        shift > EDGE * np.sqrt(2) * prior.reach
        or abs(turn) > EDGE * prior.turn + 0.01
        or abs(np.log(zoom)) > EDGE * prior.zoom + 0.01
    ):
        raise AlignmentError(
            f"the best place is {shift:.1f} m, {np.degrees(turn):.1f} degrees and "
            f"{100 * (zoom - 1):.1f} % off, beyond the range that was searched. Name a wider one"
        )


def _range(end: float, step: float) -> Float[Array, "n"]:
    count = int(np.ceil(end / step))
    return np.arange(-count, count + 1) * step


def _extent(aim: AIM) -> str:
    (left, low), (right, high) = aim.corners.min(axis=0), aim.corners.max(axis=0)
    return f"from ({left:.0f}, {low:.0f}) to ({right:.0f}, {high:.0f}) m"
