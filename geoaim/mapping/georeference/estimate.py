"""Estimate a georeference from ground control points."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import GeoreferenceError, warn
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.world import (
    LONLAT,
    World,
    choose_world,
    describe_crs_problem,
    find_operation,
    transform_crs,
    warn_of_operation,
    world_from_crs,
)
from geoaim.mapping.georeference import point_checks
from geoaim.mapping.georeference.control_points import ControlPoints, select_points
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.model_choice import (
    Candidate,
    choose_model,
    compute_probabilities,
    fit_candidates,
    fit_similarity_candidate,
)
from geoaim.mapping.georeference.outliers import SIGMA_DOF, reject_outlier
from geoaim.mapping.georeference.posterior import fit_posterior
from geoaim.mapping.georeference.transform_models import (
    PointPairs,
    Points,
    Posterior,
    apply_terms,
    compose_world_from_image,
    fit_similarity,
    fit_terms,
    half_diagonal,
    normalise_pixels,
    select_pairs,
)

# as a share of the points' distance from their centre: more than any surveying error
MAX_NOISE = 0.1
MIN_POINTS_UNUSUAL = 6  # points that prove more stretch or perspective than these two:
MAX_STRETCH, MAX_PERSPECTIVE = 0.08, 0.45
# smallest denominator of the transform at the image's corners; at the horizon it is 0
MIN_DENOMINATOR = 0.1
MAX_RADIAL = 0.3  # lens term; beyond it the lens folds the image


def estimate_georeference(
    points: ControlPoints,
    *,
    height: int,
    width: int,
    world: World | None = None,
    outside: bool = False,
    similarity: bool = False,
) -> Georeference:
    """Estimate the transform from an image to the world from control points picked on it.

    The transform model that the points make most probable is chosen (`model_choice`). One clearly
    wrong point is left out, with a warning. Tilt, stretch and lens that the points cannot show
    enter the uncertainty at their expected size (`posterior`).

    Args:
        points: at least four points on one image, better six or more, spread over it.
        height: height of the image, pixels.
        width: width of the image, pixels.
        world: the target plane; None: `choose_world` with the points' CRS if it is metric, else
            with their UTM zone; a local plane for local points.
        outside: whether points may lie outside the image, since other images showed them.
        similarity: whether the image is known to be free of tilt, stretch and lens distortion, as
            an orthophoto is; the points then tell shift, rotation and scale only.

    Returns:
        The georeference, with the residual of each point and the uncertainty of any pixel.

    Raises:
        GeoreferenceError: the points are too few, repeated, on a line, mirrored, outside the
            image, at an impossible scale, or one is wrong and it cannot be told which.
    """
    size = (height, width)
    world, targets = project_points(points, world)
    point_checks.check_layout(points, targets, size, outside=outside)
    plane = normalise_pixels(points.pixels, size)
    world_from_plane = fit_similarity(plane, targets)[0]
    scale = world_from_plane[:2, :2]
    metres = float(np.sqrt(np.linalg.det(scale)))
    ground = transform_points(np.linalg.inv(world_from_plane), targets)
    pairs = PointPairs(plane, ground, _compute_whitening(points, scale / metres))
    picking = point_checks.PICKING_SIGMA_PX / half_diagonal(*size)
    sigma = max(picking, points.accuracy / metres)
    used = reject_outlier(points.names, pairs, sigma)
    inliers = select_points(points, np.flatnonzero(used).tolist())
    if not used.all():
        point_checks.check_layout(inliers, targets[used], size, outside=outside)
    fitted = select_pairs(pairs, used)
    posterior, candidates = _fit_models(inliers.names, fitted, sigma, size, similarity)
    covariance = posterior.covariance * points.redundancy
    covariance[[0, 1], [0, 1]] += (points.common_error / metres) ** 2  # of the shift
    posterior = replace(posterior, covariance=covariance)
    best = choose_model(candidates)
    residuals = apply_terms(best.terms, plane) - pairs.ground
    leave_one_out = np.linalg.norm(residuals, axis=1)
    leave_one_out[used] = np.linalg.norm(best.leave_one_out, axis=1)
    _warn_of_few_points(inliers.names, leave_one_out[used], fitted, metres)
    return Georeference(
        world_from_image=compose_world_from_image(world_from_plane, best.terms, size),
        world=world,
        model=best.model,
        radial=float(best.terms[8]),
        height=height,
        width=width,
        pixels=points.pixels,
        residuals=residuals @ scale.T,
        leave_one_out=leave_one_out * metres,
        used=used,
        probabilities=compute_probabilities(candidates),
        noise=posterior.noise * metres,
        terms=best.terms,
        posterior=posterior,
        world_from_plane=world_from_plane,
        datum_accuracy=_measure_datum_accuracy(points, world),
    )


def _measure_datum_accuracy(points: ControlPoints, world: World) -> float:
    """Accuracy (m) of the transformation to the world's CRS; 0 where PROJ does not know it."""
    if points.crs is None or world.crs is None or points.crs == world.crs:
        return 0.0
    operation = find_operation(points.crs, world.crs, points.coordinates)
    warn_of_operation(operation, points.crs, world.crs)
    return float(np.nan_to_num(operation.accuracy))


def _compute_whitening(
    points: ControlPoints, world_from_plane: Float[Array, "2 2"]
) -> Float[Array, "m 2 2"] | None:
    """Compute the whitening of errors in the normalised plane, in units of a typical one."""
    if points.information is None:
        return None
    information = world_from_plane.T @ points.information @ world_from_plane
    typical = np.exp(np.log(np.linalg.det(information)).mean() / 2)
    return np.linalg.cholesky(information / typical).transpose(0, 2, 1)


def project_points(points: ControlPoints, world: World | None) -> tuple[World, Points]:
    """Choose the world where none is given, and transform the coordinates to its metres."""
    point_checks.check_coordinates(points)
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


def _fit_models(
    names: tuple[str, ...], pairs: PointPairs, sigma: float, size: tuple[int, int], similarity: bool
) -> tuple[Posterior, list[Candidate]]:
    """Fit the posterior and each transform model, and check that they are possible."""
    posterior = fit_posterior(pairs, sigma, 0.0, similarity=similarity)
    if similarity:
        candidates = [fit_similarity_candidate(pairs, posterior, sigma)]
    else:
        candidates = fit_candidates(pairs, posterior, sigma)
    _check_horizon(choose_model(candidates), posterior, size)
    _check_plausibility(names, posterior, _measure_spread(pairs))
    return posterior, candidates


def _check_horizon(best: Candidate, posterior: Posterior, size: tuple[int, int]) -> None:
    """Check that the chosen model and the posterior are regular over the whole image."""
    corners = normalise_pixels(image_corners(*size), size)
    for terms in (best.terms, posterior.mean):
        if (1.0 + corners @ terms[6:8]).min() < MIN_DENOMINATOR or abs(terms[8]) > MAX_RADIAL:
            raise GeoreferenceError(
                "The control points put the horizon, or a fold of the lens, inside the image. Crop"
                " it to the ground below the camera, or check the points."
            )


def _check_plausibility(names: tuple[str, ...], posterior: Posterior, spread: float) -> None:
    """Check that a transform fits the points, and that few points do not need an unusual one."""
    if posterior.noise > MAX_NOISE * spread:
        raise GeoreferenceError(
            f"No place fits the control points ({', '.join(names)}): they disagree by"
            f" {100 * posterior.noise / spread:.0f} % of their distances. Are they in the right"
            " order, on this image, and in the CRS that they state?"
        )
    stretch, perspective = np.hypot(*posterior.mean[4:6]), np.hypot(*posterior.mean[6:8])
    unusual = stretch > MAX_STRETCH or perspective > MAX_PERSPECTIVE
    if len(names) < MIN_POINTS_UNUSUAL and unusual:
        raise GeoreferenceError(
            f"{', '.join(names)} fit only an image stretched by {200 * stretch:.0f} % or seen at a"
            " steep slant: one of them is likely wrong. Check them;"
            f" {MIN_POINTS_UNUSUAL} points would prove it."
        )


def _warn_of_few_points(
    names: tuple[str, ...], leave_one_out: Float[Array, "m"], pairs: PointPairs, metres: float
) -> None:
    """Warn where points are too few to tell a tilted camera from a wrong point."""
    far = leave_one_out > MAX_NOISE * _measure_spread(pairs)
    if len(names) < MIN_POINTS_UNUSUAL and far.any():
        worst = int(np.argmax(leave_one_out))
        warn(
            f"{names[worst]} lies {leave_one_out[worst] * metres:.3g} m from where the other"
            f" {len(names) - 1} points put it: the camera is tilted, or a point is wrong, which so"
            f" few cannot tell. {MIN_POINTS_UNUSUAL} points would."
        )


def _measure_spread(pairs: PointPairs) -> float:
    """Mean distance of the points from their centre, in the normalised plane."""
    return float(np.linalg.norm(pairs.image - pairs.image.mean(axis=0), axis=1).mean())


MIN_PRELIMINARY_POINTS = 2


def estimate_preliminary(
    points: ControlPoints, *, height: int, width: int, world: World | None = None
) -> Georeference:
    """Estimate a similarity from control points that do not suffice for `estimate_georeference`.

    No point is tested for mistakes. Tilt, stretch and lens enter the uncertainty at their expected
    size (`posterior`), and the noise is that of picking points.

    Args:
        points: two points or more on one image.
        height: height of the image, pixels.
        width: width of the image, pixels.
        world: the target plane; None: see `estimate_georeference`.

    Returns:
        The georeference, marked approximate; leave-one-out errors are NaN.

    Raises:
        GeoreferenceError: there are fewer than two points, or two have the same pixel or place.
    """
    if len(points.names) < MIN_PRELIMINARY_POINTS:
        raise GeoreferenceError(
            f"{len(points.names)} control points were given; {MIN_PRELIMINARY_POINTS} are needed"
            " for a first georeference"
        )
    size = (height, width)
    world, targets = project_points(points, world)
    point_checks.check_distinctness(points, targets)
    plane = normalise_pixels(points.pixels, size)
    world_from_plane = fit_similarity(plane, targets)[0]
    pairs = PointPairs(plane, transform_points(np.linalg.inv(world_from_plane), targets))
    sigma = point_checks.PICKING_SIGMA_PX / half_diagonal(*size)
    posterior = fit_posterior(pairs, sigma, SIGMA_DOF)
    terms = fit_terms(pairs, [0, 1, 2, 3], np.zeros(9))
    scale = world_from_plane[:2, :2]
    return Georeference(
        world_from_image=compose_world_from_image(world_from_plane, terms, size),
        world=world,
        model="similarity",
        radial=0.0,
        height=height,
        width=width,
        pixels=points.pixels,
        residuals=(apply_terms(terms, plane) - pairs.ground) @ scale.T,
        leave_one_out=np.full(len(plane), np.nan),
        used=np.ones(len(plane), bool),
        probabilities={},
        noise=posterior.noise * float(np.sqrt(np.linalg.det(scale))),
        terms=terms,
        posterior=posterior,
        world_from_plane=world_from_plane,
        approximate=True,
    )
