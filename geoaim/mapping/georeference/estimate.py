"""Estimate a georeference from ground control points."""

import warnings
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.special import chdtrc

from geoaim.errors import GeoaimWarning, GeoreferenceError
from geoaim.geometry import image_corners, transform_points
from geoaim.mapping.georeference.control_points import ControlPoints, select_points
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.normalised_plane import (
    Points,
    fit_similarity,
    half_diagonal,
    normalise_pixels,
)
from geoaim.mapping.georeference.outliers import find_used_points
from geoaim.mapping.georeference.point_checks import check_coordinates, check_layout
from geoaim.mapping.georeference.posterior import NoisePrior, fit_posterior
from geoaim.mapping.georeference.transform_models import (
    Candidate,
    PointPairs,
    Posterior,
    apply_terms,
    choose_model,
    compose_world_from_image,
    fit_candidates,
    select_pairs,
)
from geoaim.world import (
    LONLAT,
    World,
    choose_world,
    describe_crs_problem,
    transform_crs,
    world_from_crs,
)

DEFAULT_ACCURACY = 2.0  # px, one sigma of a picked point where the caller states none
DEFAULT_ACCURACY_DOF = 3.0  # degrees of freedom that this counts for in the search for outliers
STATED_ACCURACY_DOF = 50.0  # and that an accuracy stated by the caller counts for
MIN_ACCURACY_CHANCE = 0.00135  # a stated accuracy less likely than this (3 sigma) is refuted
MAX_NOISE = 0.02  # of half the diagonal: 22 px at 1080p, beyond any picking error
MIN_POINTS_UNUSUAL = 6  # points that prove more stretch or perspective than these two:
MAX_STRETCH, MAX_PERSPECTIVE = 0.08, 0.45
MIN_DENOMINATOR = 0.1  # of the transform at the image's corners: above the horizon's 0
MAX_RADIAL = 0.3  # lens term; beyond it the lens folds the image


@dataclass(frozen=True)
class _Problem:
    """Control points to fit, in world metres and in the normalised plane."""

    points: ControlPoints
    world: World
    targets: Points
    pairs: PointPairs
    world_from_plane: Float[Array, "3 3"]
    size: tuple[int, int]


@dataclass(frozen=True)
class _Fit:
    """Points that were used, and the models fitted to them."""

    used: Bool[Array, "m"]
    posterior: Posterior
    candidates: list[Candidate]
    best: Candidate


def estimate_georeference(
    points: ControlPoints,
    *,
    height: int,
    width: int,
    world: World | None = None,
    accuracy: float | None = None,
) -> Georeference:
    """Estimate the transform from an image to the world from control points picked on it.

    The simplest transform model with a leave-one-out error near the best is chosen. One clearly
    wrong point is left out, with a warning. Tilt, stretch and lens that the points cannot show
    enter the uncertainty at their expected size (`posterior`).

    Args:
        points: at least four on one image, better six or more, spread over it.
        height: of the image, pixels.
        width: of the image, pixels.
        world: the target plane; None keeps the points' CRS if it is metric, else chooses UTM.
        accuracy: one sigma of a point's coordinates, pixels, picking and survey together. None
            assumes 2 px in the search for wrong points, and estimates it from the residuals.

    Returns:
        The georeference.

    Raises:
        GeoreferenceError: the points are too few, repeated, on a line, mirrored, outside the
            image, at an impossible scale, or one is wrong and it cannot be told which.
    """
    if accuracy is not None and not accuracy > 0.0:
        raise ValueError(f"accuracy is {accuracy}; it is a positive number of pixels.")
    size = (height, width)
    world, targets = _project_points(points, world)
    check_layout(points, targets, size, max(accuracy or DEFAULT_ACCURACY, 1.0))
    plane = normalise_pixels(points.pixels, size)
    world_from_plane = fit_similarity(plane, targets)[0]
    pairs = PointPairs(plane, transform_points(np.linalg.inv(world_from_plane), targets))
    problem = _Problem(points, world, targets, pairs, world_from_plane, size)
    return _assemble_georeference(problem, _fit_models(problem, accuracy))


def _project_points(points: ControlPoints, world: World | None) -> tuple[World, Points]:
    """Choose the world where none is given, and transform the coordinates to its metres."""
    check_coordinates(points)
    if points.crs is None:
        if world is not None and world.crs is not None:
            raise GeoreferenceError(
                f"The control points are in a plane of their own, the world is {world.crs}: give"
                " the points' CRS, or no world."
            )
        world = world or World(None)
        return world, points.coordinates - world.origin
    if world is None:
        lonlat = transform_crs(points.crs, LONLAT, points.coordinates)
        east, north = points.coordinates.mean(axis=0).tolist()
        metric = not describe_crs_problem(points.crs, (east, north))
        world = choose_world(lonlat, crs=points.crs if metric else None)
    return world, world_from_crs(world, points.coordinates, points.crs)


def _fit_models(problem: _Problem, accuracy: float | None) -> _Fit:
    """Leave out a wrong point, decide on the noise, and fit the models to the others."""
    points, pairs, size = problem.points, problem.pairs, problem.size
    prior = _choose_noise_prior(pairs, accuracy, size)
    used = find_used_points(points.names, pairs, prior)
    if not used.all():
        points = select_points(points, np.flatnonzero(used).tolist())
        pairs = select_pairs(pairs, used)
        check_layout(points, problem.targets[used], size, max(accuracy or DEFAULT_ACCURACY, 1.0))
        if prior.dof != STATED_ACCURACY_DOF:
            prior = _choose_noise_prior(pairs, accuracy, size)
    if prior.dof != STATED_ACCURACY_DOF:
        prior = NoisePrior(prior.sigma, 0.0)
        if accuracy is not None:
            warnings.warn(
                f"The control points disagree by more than the stated accuracy of {accuracy:g} px"
                " allows; the uncertainty follows their disagreement.",
                GeoaimWarning,
                stacklevel=3,
            )
    posterior = fit_posterior(pairs, prior)
    candidates = fit_candidates(pairs, posterior)
    best = choose_model(candidates)
    _check_horizon(best, posterior, size)
    _check_plausibility(points.names, posterior)
    return _Fit(used, posterior, candidates, best)


def _choose_noise_prior(
    pairs: PointPairs, accuracy: float | None, size: tuple[int, int]
) -> NoisePrior:
    """Trust a stated accuracy, unless a chi-square test of the residuals refutes it."""
    sigma = (accuracy or DEFAULT_ACCURACY) / half_diagonal(*size)
    if accuracy is None:
        return NoisePrior(sigma, DEFAULT_ACCURACY_DOF)
    stated = NoisePrior(sigma, STATED_ACCURACY_DOF)
    posterior = fit_posterior(pairs, stated)
    freedom = max(posterior.dof - STATED_ACCURACY_DOF, 0.5)
    squares = posterior.noise**2 * posterior.dof / sigma**2 - STATED_ACCURACY_DOF
    refuted = chdtrc(freedom, max(squares, 0.0)) < MIN_ACCURACY_CHANCE
    return NoisePrior(sigma, DEFAULT_ACCURACY_DOF) if refuted else stated


def _check_horizon(best: Candidate, posterior: Posterior, size: tuple[int, int]) -> None:
    """Check that the chosen model and the posterior are regular over the whole image."""
    corners = normalise_pixels(image_corners(*size), size)
    for terms in (best.terms, posterior.mean):
        if (1.0 + corners @ terms[6:8]).min() < MIN_DENOMINATOR or abs(terms[8]) > MAX_RADIAL:
            raise GeoreferenceError(
                "The control points put the horizon, or a fold of the lens, inside the image. Crop"
                " it to the ground below the camera, or check the points."
            )


def _check_plausibility(names: tuple[str, ...], posterior: Posterior) -> None:
    """Check that a transform fits the points, and that few points do not need an unusual one."""
    if posterior.noise > MAX_NOISE:
        raise GeoreferenceError(
            f"No place fits the control points ({', '.join(names)}): they disagree by"
            f" {100 * posterior.noise:.0f} % of half the image's diagonal. Are they in the right"
            " order, on this image, and in the CRS that they claim?"
        )
    stretch, perspective = np.hypot(*posterior.mean[4:6]), np.hypot(*posterior.mean[6:8])
    unusual = stretch > MAX_STRETCH or perspective > MAX_PERSPECTIVE
    if len(names) < MIN_POINTS_UNUSUAL and unusual:
        raise GeoreferenceError(
            f"{', '.join(names)} fit only an image stretched by {200 * stretch:.0f} % or seen at a"
            " steep slant: one of them is likely wrong. Check them;"
            f" {MIN_POINTS_UNUSUAL} points would prove it."
        )


def _assemble_georeference(problem: _Problem, fit: _Fit) -> Georeference:
    """Convert the fit to world metres."""
    scale, best = problem.world_from_plane[:2, :2], fit.best
    metres = float(np.sqrt(np.linalg.det(scale)))
    matrix = compose_world_from_image(problem.world_from_plane, best.terms, problem.size)
    residuals = apply_terms(best.terms, problem.pairs.image) - problem.pairs.ground
    leave_one_out = np.linalg.norm(residuals, axis=1)
    leave_one_out[fit.used] = np.linalg.norm(best.leave_one_out, axis=1)
    return Georeference(
        world_from_image=matrix,
        world=problem.world,
        model=best.model,
        radial=float(best.terms[8]),
        height=problem.size[0],
        width=problem.size[1],
        residuals=residuals @ scale.T,
        leave_one_out=leave_one_out * metres,
        used=fit.used,
        names=problem.points.names,
        candidates={
            c.model: float(np.sqrt(np.mean(np.sum(c.leave_one_out**2, axis=1)))) * metres
            for c in fit.candidates
        },
        noise=fit.posterior.noise * metres,
        terms=best.terms,
        posterior=fit.posterior,
        world_from_plane=problem.world_from_plane,
    )
