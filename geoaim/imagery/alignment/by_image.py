"""Alignment of imagery to an AIM of the same place.

1. Coarse: all rotations and scales of the prior, each at all shifts, on a small grid.
2. Fine: windows of the AIM are found in the imagery on ever finer grids, and a motion model is
   fitted robustly to their shifts.
3. Verification: all windows are searched once more in a wide square, and those that agree with the
   model are counted. Their number must be unlikely by chance, and no other place may have nearly
   as many.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.imagery.alignment.candidates import (
    AlignmentCandidate,
    count_agreements,
    find_repetitions,
    refine_candidates,
    search_grid,
)
from geoaim.imagery.alignment.pyramid import WINDOW_PX, Level, build_pyramid
from geoaim.imagery.alignment.result import DEFAULT_PRIOR, ImageryAlignment, Prior
from geoaim.imagery.alignment.verification import verify_candidates
from geoaim.mapping.registration.motion_models import (
    Model,
    Motion,
    choose_model,
    compute_basis,
    fit_matches,
)

MODELS: tuple[Model, ...] = ("translation", "rigid", "similarity", "affine", "homography")
REFINEMENTS = 2  # on the finest grid
MIN_MODEL_GAIN_PX = 0.1  # of the finest grid: a smaller gain is not worth a richer model
MIN_SIGMA_PX = 0.1  # of the finest grid: a sensor's own geometry is no better known
CORRELATED_WINDOWS = 3.0  # windows that shadows and changes shift together


def align_image(imagery: AIM, aim: AIM, *, prior: Prior = DEFAULT_PRIOR) -> ImageryAlignment:
    """Estimate how imagery has to be moved to lie on an AIM of the same place.

    Args:
        imagery: georeferenced roughly; of any sensor, day and resolution.
        aim: georeferenced well, in the same world.
        prior: how far off the imagery may be.

    Returns:
        The alignment, with its covariance; evidence has the number of windows, of those that
        agree, and log10 of the number of false alarms.

    Raises:
        AlignmentError: both overlap too little, have too little in common, or fit in two ways.
        ValueError: they lie in different worlds.
    """
    if imagery.world != aim.world:
        raise ValueError(f"the imagery lies in {imagery.world}, the AIM in {aim.world}")
    coarsest, *between, finest = build_pyramid(imagery, aim, prior)
    places = search_grid(coarsest, prior)
    for level in (*between, *[finest] * REFINEMENTS):
        places = refine_candidates(level, places)
    candidates = [count_agreements(finest, place) for place in places]
    if candidates:
        best = max(candidates, key=lambda candidate: candidate.agreeing)
        others = find_repetitions((between or [finest])[-1], best.stated_from_true, prior)
        candidates += [count_agreements(finest, x) for x in refine_candidates(finest, others)]
    candidates.sort(key=lambda candidate: -candidate.agreeing)
    false_alarms = verify_candidates(candidates, finest, prior)
    return _fit_alignment(candidates[0], finest, false_alarms)


def _fit_alignment(best: AlignmentCandidate, level: Level, false_alarms: float) -> ImageryAlignment:
    """The simplest motion model that the windows support, and its covariance."""
    grid = level.grid
    in_a_row = np.ptp(best.matches.source, axis=0).min() < WINDOW_PX
    model = choose_model(
        [best.matches],
        size=grid.shape,
        models=MODELS[:3] if in_a_row else MODELS,
        redundancy=level.overlap,
        min_gain=MIN_MODEL_GAIN_PX,
    ).model
    motion = fit_matches(best.matches, model, size=grid.shape)
    stated_from_true = grid.world_from_grid @ motion.matrix @ grid.grid_from_world
    variance = _average_covariance(motion, grid.shape) * CORRELATED_WINDOWS * level.overlap
    return ImageryAlignment(
        true_from_stated=np.linalg.inv(stated_from_true),
        model=model,
        covariance=(variance + MIN_SIGMA_PX**2 * np.eye(2)) * grid.resolution**2,
        center=grid.corners.mean(axis=0),
        evidence={
            "windows": best.windows,
            "windows_agreeing": best.agreeing,
            "log10_false_alarms": false_alarms,
        },
    )


def _average_covariance(motion: Motion, size: tuple[int, int]) -> Float[Array, "2 2"]:
    """Covariance of a point in square pixels, averaged over the image, y up."""
    height, width = size
    grid = np.stack(np.meshgrid(np.linspace(0, width, 7), np.linspace(0, height, 7)), -1)
    columns = compute_basis(grid.reshape(-1, 2), motion.model, size=size) * [[1.0], [-1.0]]
    return np.einsum("mik,kl,mjl->ij", columns, motion.covariance, columns) / len(columns)
