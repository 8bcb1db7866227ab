"""Georeference: where an image lies in the world, and how far to trust that."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.errors import GeoaimWarning, GeoreferenceError
from geoaim.geometry import image_corners, transform_points
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.point_checks import (
    fit_similarity,
    half_diagonal,
    plane_from_image,
    plane_points,
    refuse_coordinates,
    refuse_layout,
)
from geoaim.mapping.georeference.transform_models import (
    Candidate,
    Posterior,
    apply,
    apply_with_jacobian,
    choose,
    ellipse_factor,
    find_suspects,
    fit_candidates,
    fit_posterior,
)
from geoaim.world import (
    LONLAT,
    World,
    choose_world,
    describe_crs_problem,
    transform_crs,
    world_from_crs,
)

EXPECTED = 2.0  # px, one sigma of a picked point where the caller states none
EXPECTED_TRUST = 3.0  # degrees of freedom that this counts for in the search for wrong points
PROOF = 6  # points that may show more stretch or perspective than this by themselves
MOST_STRETCH, MOST_PERSPECTIVE = 0.08, 0.45
MOST_NOISE = 0.02  # of half the diagonal: 22 px at 1080p, beyond any picking
STATED_TRUST = 50.0  # and that an accuracy stated by the caller counts for


@dataclass(frozen=True)
class Georeference:
    """Where an image lies in the world.

    Attributes:
        world_from_image: (3, 3) pixels to world metres; where `radial` is not 0, pixels that
            `undistort_points` has straightened.
        world: the plane of those metres.
        model: "similarity", "affine" or "homography".
        radial: k of p' = p (1 + k |p|^2), p from the image's centre in half diagonals.
        height: of the image, pixels.
        width: of the image, pixels.
        residuals: (M, 2) fitted minus given, metres, of every point, used or not.
        leave_one_out: (M,) distance by which a fit without the point misses it, metres.
        used: (M,) False for a point that was found to be wrong.
        names: (M,) of the points.
        candidates: root mean square leave-one-out error of each model that was tried, metres.
        noise: one sigma of one coordinate of a control point, metres.
        dof: degrees of freedom behind the noise.
        parameters: (9,) most probable values of the nine terms of `transform_models`.
        covariance: (9, 9) of `parameters`.
        chosen: (9,) the terms of the chosen model, zero where it has none.
        world_from_plane: (3, 3) similarity from that module's normalised plane to the world.
        approximate: True when it rests on telemetry, or on nothing, and not on control points.
    """

    world_from_image: Float[Array, "3 3"]
    world: World
    model: str
    radial: float
    height: int
    width: int
    residuals: Float[Array, "m 2"]
    leave_one_out: Float[Array, "m"]
    used: Bool[Array, "m"]
    names: tuple[str, ...]
    candidates: Mapping[str, float] = field(repr=False)
    noise: float
    dof: float
    parameters: Float[Array, "9"] = field(repr=False)
    covariance: Float[Array, "9 9"] = field(repr=False)
    chosen: Float[Array, "9"] = field(repr=False)
    world_from_plane: Float[Array, "3 3"] = field(repr=False)
    approximate: bool = False


def georeference(
    points: ControlPoints,
    *,
    height: int,
    width: int,
    world: World | None = None,
    accuracy: float | None = None,
) -> Georeference:
    """Find where an image lies from control points picked on it.

    The model is chosen by leave-one-out error, the least that does nearly as well as the best; one
    clearly wrong point is left out, with a warning. What the points cannot show (tilt, stretch,
    lens) is part of the uncertainty at its expected size: see `transform_models`.

    Args:
        points: at least four on one image, better six or more, spread over it.
        height: of the image, pixels.
        width: of the image, pixels.
        world: where to; None keeps the points' CRS when it is metric, and chooses UTM when not.
        accuracy: one sigma of a point's coordinates, pixels, picking and survey together. None
            expects some 2 px to find wrong points, and takes the noise from the residuals.

    Raises:
        GeoreferenceError: the points are too few, repeated, on a line, mirrored, outside the
            image, at an absurd scale, or one is wrong and it cannot be told which.
    """
    if accuracy is not None and not accuracy > 0.0:
        raise ValueError(f"accuracy is {accuracy}; it is a positive number of pixels.")
    size = (height, width)
    world, targets = _place(points, world)
    refuse_layout(points, targets, size, max(accuracy or EXPECTED, 1.0))
    plane = plane_points(points.pixels, *size)
    sigma = (accuracy or EXPECTED) / half_diagonal(*size)
    world_from_plane = fit_similarity(plane, targets)[0]
    placed = transform_points(np.linalg.inv(world_from_plane), targets)
    trust = _trust(plane, placed, sigma, stated=accuracy is not None)
    used = _find_used(points, plane, placed, (sigma, trust))
    if not used.all():
        refuse_layout(_take(points, used), targets[used], size, max(accuracy or EXPECTED, 1.0))
    if trust != STATED_TRUST and accuracy is not None:
        trust = _trust(plane[used], placed[used], sigma, stated=True)
        if trust != STATED_TRUST:
            warnings.warn(_understated(accuracy), GeoaimWarning, stacklevel=2)
    believed = trust if trust == STATED_TRUST else 0.0
    posterior = fit_posterior(plane[used], placed[used], sigma, believed)
    candidates = fit_candidates(plane[used], placed[used], posterior)
    best = choose(candidates)
    _refuse_horizon(best, posterior, size)
    _refuse_unproven(_take(points, used).names, posterior)
    metres = _unit(world_from_plane)
    offset = apply(best.parameters, plane) - placed
    left_out = np.linalg.norm(offset, axis=1)
    left_out[used] = np.linalg.norm(best.leave_one_out, axis=1)
    return Georeference(
        world_from_image=compose(world_from_plane, best.parameters, size),
        world=world,
        model=best.model,
        radial=float(best.parameters[8]),
        height=height,
        width=width,
        residuals=offset @ world_from_plane[:2, :2].T,
        leave_one_out=left_out * metres,
        used=used,
        names=points.names,
        candidates={c.model: _rms(c) * metres for c in candidates},
        noise=posterior.noise * metres,
        dof=posterior.dof,
        parameters=posterior.parameters,
        covariance=posterior.covariance,
        chosen=best.parameters,
        world_from_plane=world_from_plane,
    )


def _place(points: ControlPoints, world: World | None) -> tuple[World, Float[Array, "m 2"]]:
    """The world, and the points' metres in it."""
    refuse_coordinates(points)
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


def _trust(
    plane: Float[Array, "m 2"], placed: Float[Array, "m 2"], sigma: float, *, stated: bool
) -> float:
    """Degrees of freedom for the expected accuracy: few when it was not stated, or is refuted.

    Refuted is a chi-square of the residuals beyond three sigma (Wilson and Hilferty 1931).
    """
    if not stated:
        return EXPECTED_TRUST
    posterior = fit_posterior(plane, placed, sigma, STATED_TRUST)
    freedom = max(posterior.dof - STATED_TRUST, 0.5)
    ratio = (posterior.noise**2 * posterior.dof / sigma**2 - STATED_TRUST) / freedom
    spread = 2.0 / (9.0 * freedom)
    return EXPECTED_TRUST if np.cbrt(ratio) > 1.0 - spread + 3.0 * np.sqrt(spread) else STATED_TRUST


def _understated(accuracy: float) -> str:
    return (
        f"The control points disagree by more than the stated accuracy of {accuracy:g} px allows;"
        " the uncertainty follows their disagreement."
    )


def _find_used(
    points: ControlPoints,
    plane: Float[Array, "m 2"],
    placed: Float[Array, "m 2"],
    prior: tuple[float, float],
) -> Bool[Array, "m"]:
    """All points but one that is clearly wrong."""
    used = np.ones(len(plane), bool)
    suspects = find_suspects(plane, placed, *prior)
    if not suspects:
        return used
    if len(suspects) == 1 and len(plane) > 4:
        used[suspects[0]] = False
        more = find_suspects(plane[used], placed[used], *prior)
        suspects += np.flatnonzero(used)[more].tolist()
    if len(suspects) > 1 or used.all():
        raise GeoreferenceError(
            f"The control points contradict each other; wrong may be"
            f" {', '.join(points.names[i] for i in suspects)}. Check these first, or add points so"
            " that the wrong ones can be told."
        )
    name, offset = points.names[suspects[0]], _offset(plane, placed, used, prior)
    warnings.warn(
        f"{name} is left out: it lies {offset:.3g} times the picking error from where the other"
        f" {used.sum()} points put it. Check its pixel and its coordinates.",
        GeoaimWarning,
        stacklevel=3,
    )
    return used


def _take(points: ControlPoints, used: Bool[Array, "m"]) -> ControlPoints:
    kept = np.flatnonzero(used).tolist()
    return replace(
        points,
        pixels=points.pixels[kept],
        coordinates=points.coordinates[kept],
        names=tuple(points.names[i] for i in kept),
        frames=tuple(points.frames[i] for i in kept),
    )


def _offset(
    plane: Float[Array, "m 2"],
    placed: Float[Array, "m 2"],
    used: Bool[Array, "m"],
    prior: tuple[float, float],
) -> float:
    terms = fit_posterior(plane[used], placed[used], *prior).parameters
    return float(np.linalg.norm(apply(terms, plane[~used]) - placed[~used]) / prior[0])


def _refuse_horizon(best: Candidate, posterior: Posterior, size: tuple[int, int]) -> None:
    corners = plane_points(image_corners(*size), *size)
    for terms in (best.parameters, posterior.parameters):
        if (1.0 + corners @ terms[6:8]).min() < 0.1 or abs(terms[8]) > 0.3:
            raise GeoreferenceError(
                "The control points put the horizon, or a fold of the lens, inside the image. Crop"
                " it to the ground below the camera, or check the points."
            )


def _refuse_unproven(names: tuple[str, ...], posterior: Posterior) -> None:
    """Refuse points that nothing fits, and few points that only an unlikely picture fits."""
    if posterior.noise > MOST_NOISE:
        raise GeoreferenceError(
            f"No place fits the control points ({', '.join(names)}): they disagree by"
            f" {100 * posterior.noise:.0f} % of half the image's diagonal. Are they in the right"
            " order, on this picture, and in the CRS that they claim?"
        )
    terms = posterior.parameters
    stretch, perspective = np.hypot(*terms[4:6]), np.hypot(*terms[6:8])
    if len(names) < PROOF and (stretch > MOST_STRETCH or perspective > MOST_PERSPECTIVE):
        raise GeoreferenceError(
            f"{', '.join(names)} fit only a picture stretched by {200 * stretch:.0f} % or seen at a"
            f" steep slant: one of them is likely wrong. Check them; {PROOF} points would prove it."
        )


def _rms(candidate: Candidate) -> float:
    return float(np.sqrt(np.mean(np.sum(candidate.leave_one_out**2, axis=1))))


def _unit(world_from_plane: Float[Array, "3 3"]) -> float:
    return float(np.sqrt(np.linalg.det(world_from_plane[:2, :2])))


def compose(
    world_from_plane: Float[Array, "3 3"], terms: Float[Array, "9"], size: tuple[int, int]
) -> Float[Array, "3 3"]:
    """World from image, by the first eight of the nine terms; size is height and width."""
    tx, ty, s, r, a, b, cx, cy, _ = terms
    plane = np.array([[1.0 + s + a, b - r, tx], [b + r, 1.0 + s - a, ty], [cx, cy, 1.0]])
    matrix = world_from_plane @ plane @ plane_from_image(*size)
    return np.asarray(matrix / matrix[2, 2])


def world_points(georeference: Georeference, pixels: Float[Array, "m 2"]) -> Float[Array, "m 2"]:
    """World metres of pixels as they were picked, lens included."""
    size = (georeference.height, georeference.width)
    straight = undistort_points(pixels, georeference.radial, *size)
    return transform_points(georeference.world_from_image, straight)


def predict_covariance(
    georeference: Georeference, pixels: Float[Array, "m 2"]
) -> Float[Array, "m 2 2"]:
    """Expected squared error of `world_points`, square metres.

    J S J^T by the posterior of all nine terms (Criminisi, Reid and Zisserman 1997), and the square
    of the step from that posterior's mean to the chosen model.
    """
    plane = plane_points(pixels, georeference.height, georeference.width)
    mean, jacobian = apply_with_jacobian(georeference.parameters, plane)
    step = apply(georeference.chosen, plane) - mean
    spread = jacobian @ georeference.covariance @ jacobian.transpose(0, 2, 1)
    spread = spread + step[:, :, None] * step[:, None, :]
    turn = georeference.world_from_plane[:2, :2]
    return np.asarray(turn @ spread @ turn.T)


def predict_uncertainty(
    georeference: Georeference, pixels: Float[Array, "m 2"]
) -> tuple[Float[Array, "m"], Float[Array, "m"]]:
    """How far pixels may be off in the world, metres, along the worst direction.

    Returns:
        One standard deviation (M,), and the half length (M,) of the ellipse that holds the true
        place in 95 % of cases: wider for few points, by the F distribution.
    """
    covariance = predict_covariance(georeference, pixels)
    sigma = np.sqrt(np.linalg.eigvalsh(covariance)[:, -1])
    return sigma, sigma * ellipse_factor(georeference.dof)


def undistort_points(
    pixels: Float[Array, "m 2"], radial: float, height: int, width: int
) -> Float[Array, "m 2"]:
    """Straighten pixels: p (1 + k |p|^2), p from the image's centre in half diagonals.

    >>> undistort_points(np.array([[0.0, 0.0]]), 0.01, 60, 80)
    array([[-0.4, -0.3]])
    """
    centre = np.array([width, height]) / 2.0
    offset = np.asarray(pixels, np.float64) - centre
    square = np.sum(offset**2, axis=-1, keepdims=True) / half_diagonal(height, width) ** 2
    return centre + offset * (1.0 + radial * square)


def distort_points(
    pixels: Float[Array, "m 2"], radial: float, height: int, width: int
) -> Float[Array, "m 2"]:
    """Undo `undistort_points`, by Newton's method on the radius."""
    centre = np.array([width, height]) / 2.0
    offset = np.asarray(pixels, np.float64) - centre
    target = np.linalg.norm(offset, axis=-1, keepdims=True) / half_diagonal(height, width)
    radius = target.copy()
    for _ in range(20):
        radius -= (radius * (1.0 + radial * radius**2) - target) / (1.0 + 3.0 * radial * radius**2)
    return centre + offset / (1.0 + radial * radius**2)
