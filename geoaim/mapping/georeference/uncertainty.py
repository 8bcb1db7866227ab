"""Uncertainty of a georeference: at any pixel, and as a map with its worst corner."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.posterior import ellipse_factor
from geoaim.mapping.georeference.transform_models import (
    Points,
    apply_terms,
    half_diagonal,
    normalise_pixels,
    term_jacobian,
)

GRID_SHAPE = (9, 15)  # places of an uncertainty map; odd, so that one is the middle
# standard deviation of a further point, at least: few points may agree better by chance
MIN_PICKING_PX = 0.5
CORNERS = ("top left", "top right", "bottom right", "bottom left")


def predict_uncertainty(
    georeference: Georeference, pixels: Points
) -> tuple[Float[Array, "m"], Float[Array, "m"]]:
    """Predict how far pixels may be off in the world, metres, along the worst direction.

    The squared error is J S J^T with the posterior covariance S of all nine terms (Criminisi, Reid
    and Zisserman 1997), plus the squared difference of the posterior's mean and the chosen model
    times the probability that this model is wrong.

    Returns:
        One standard deviation (M,), and the semi-major axis (M,) of the ellipse that holds the true
        place in 95 % of cases; by the F distribution it is larger for few points.
    """
    sigma = _measure_sigma(_design_errors(georeference, pixels))
    bound = sigma * ellipse_factor(georeference.posterior.dof)
    return np.hypot(sigma, georeference.datum_accuracy), _add_datum(georeference, bound)


def map_uncertainty(georeference: Georeference) -> dict[str, Any]:
    """Map the uncertainty over the image, now and with a further point in its worst corner.

    Returns:
        Entries of the report of an AIM: radii that hold the true place in 95 % of cases, metres, on
        a grid over the image, in its middle and worst corner, and with a control point there.
    """
    rows, columns = GRID_SHAPE
    design, dof = (
        _design_errors(georeference, _list_places(georeference)),
        georeference.posterior.dof,
    )
    grid = _add_datum(georeference, _measure_sigma(design) * ellipse_factor(dof))
    corners = [0, columns - 1, rows * columns - 1, (rows - 1) * columns]
    worst = int(np.argmax(grid[corners]))
    with_point = _predict_with_points(georeference, design, [corners[worst]])[0]
    with_point = _add_datum(georeference, with_point)
    return {
        "map_m": grid.reshape(GRID_SHAPE).round(4),
        "middle_m": float(grid[rows * columns // 2]),
        "median_m": float(np.median(grid)),
        "worst_corner": CORNERS[worst],
        "worst_corner_m": float(grid[corners[worst]]),
        "median_with_point_there_m": float(np.median(with_point)),
        "worst_corner_with_point_there_m": float(with_point[corners[worst]]),
    }


def average_covariance(georeference: Georeference) -> Float[Array, "2 2"]:
    """Average the covariance of a pixel's place over the image, square metres east and north."""
    design = _design_errors(georeference, _list_places(georeference))
    scale = (ellipse_factor(georeference.posterior.dof) / ellipse_factor(np.inf)) ** 2
    return np.asarray(scale * np.einsum("mik,mjk->ij", design, design) / len(design))


def predict_ellipses(georeference: Georeference, pixels: Points) -> Float[Array, "m 2 2"]:
    """Predict the ellipses that hold the true places of pixels in 95 % of cases.

    Returns:
        Semi-axes (M, 2, 2) as rows, in metres east and north, the longer one first. Points of an
        ellipse are its centre + cos(t) first + sin(t) second.
    """
    factor = ellipse_factor(georeference.posterior.dof)
    directions, lengths, _ = np.linalg.svd(
        _design_errors(georeference, pixels), full_matrices=False
    )
    axes = _add_datum(georeference, factor * lengths)
    return np.asarray((directions * axes[:, None, :]).transpose(0, 2, 1))


def suggest_point(georeference: Georeference) -> tuple[Float[Array, "2"], float, float]:
    """Find where one more control point would lower the largest uncertainty in the image most.

    Returns:
        (2,) the pixel to pick next, and two radii in metres: at the worst place of the image, the
        radius that holds the true place in 95 % of cases, without and with that point.
    """
    places = _list_places(georeference)
    design = _design_errors(georeference, places)
    now = _measure_sigma(design).max() * ellipse_factor(georeference.posterior.dof)
    largest = _predict_with_points(georeference, design, range(len(places))).max(axis=1)
    best = int(np.argmin(largest))
    radii = _add_datum(georeference, np.array([now, largest[best]]))
    return places[best], float(radii[0]), float(radii[1])


def _add_datum(georeference: Georeference, radius: Float[Array, "..."]) -> Float[Array, "..."]:
    """Add the uncertainty of the CRS's transformation, which points in it do not lower."""
    return np.asarray(np.hypot(radius, georeference.datum_accuracy * ellipse_factor(np.inf)))


def _list_places(georeference: Georeference) -> Points:
    """Pixels on a grid over the image, row by row."""
    rows, columns = GRID_SHAPE
    v, u = np.linspace(0, georeference.height, rows), np.linspace(0, georeference.width, columns)
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _predict_with_points(
    georeference: Georeference, design: Float[Array, "m 2 10"], added: Sequence[int]
) -> Float[Array, "n m"]:
    """Radii of 95 % at each place, with one further control point at each of the places added."""
    points = design[added]
    transposed = points.transpose(0, 2, 1)
    resolution = np.linalg.det(georeference.world_from_plane[:2, :2]) ** 0.5 / half_diagonal(
        georeference.height, georeference.width
    )
    noise = np.fmax(georeference.noise, MIN_PICKING_PX * resolution)
    gain = transposed @ np.linalg.pinv(points @ transposed + noise**2 * np.eye(2))
    remaining = np.eye(design.shape[2]) - gain @ points  # covariance of the unknowns afterwards
    x, y = design[:, 0], design[:, 1]
    xx, xy = ((x @ remaining * other).sum(axis=2) for other in (x, y))
    yy = (y @ remaining * y).sum(axis=2)
    largest = (xx + yy) / 2.0 + np.hypot((xx - yy) / 2.0, xy)  # eigenvalue of [[xx, xy], [xy, yy]]
    factor = ellipse_factor(georeference.posterior.dof + 2.0)
    return np.asarray(factor * np.sqrt(largest.clip(0.0)))


def _design_errors(georeference: Georeference, pixels: Points) -> Float[Array, "m 2 10"]:
    """Errors in metres by ten independent unknowns of unit variance.

    These are the nine terms, decorrelated, and whether another model than the chosen one holds: the
    posterior's mean then lies nearer.
    """
    terms, posterior = georeference.terms, georeference.posterior
    plane = normalise_pixels(pixels, (georeference.height, georeference.width))
    values, vectors = np.linalg.eigh(posterior.covariance)
    jacobian = term_jacobian(posterior.mean, plane) @ (vectors * np.sqrt(values.clip(0.0)))
    doubt = 1.0 - georeference.probabilities.get(georeference.model, 0.0)
    bias = np.sqrt(doubt) * (apply_terms(terms, plane) - apply_terms(posterior.mean, plane))
    scale = georeference.world_from_plane[:2, :2]
    return np.asarray(scale @ np.concatenate([jacobian, bias[:, :, None]], axis=2))


def _measure_sigma(design: Float[Array, "m 2 10"]) -> Float[Array, "m"]:
    """One standard deviation along the worst direction."""
    return np.asarray(np.linalg.norm(design, ord=2, axis=(1, 2)))
