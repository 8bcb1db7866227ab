"""Application of an alignment: imagery moved by it or checked against it, and its report."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.errors import GeoaimWarning
from geoaim.geometry import transform_points
from geoaim.imagery.alignment.result import CHI2_2D, ImageryAlignment


def apply_alignment(imagery: AIM, alignment: ImageryAlignment) -> AIM:
    """Move imagery to where an alignment places it."""
    return replace(imagery, world_from_image=alignment.true_from_stated @ imagery.world_from_image)


def report_alignment(alignment: ImageryAlignment) -> dict[str, Any]:
    """Describe an alignment for the report of an AIM, in metres and degrees."""
    matrix, direction = alignment.true_from_stated, alignment.undetermined_direction
    east = np.array([[0.0, 0.0], [1.0, 0.0]]) + alignment.center
    start, end = transform_points(matrix, east)
    return {
        "model": alignment.model,
        "shift_m": alignment.shift,
        "rotation_degrees": float(np.degrees(np.arctan2(*(end - start)[::-1]))),
        "scale": float(np.linalg.norm(end - start)),
        "uncertainty_m": alignment.uncertainty,
        "covariance_m2": alignment.covariance,
        "undetermined_degrees": None if direction is None else float(np.degrees(direction)),
        "true_from_stated": matrix,
        **alignment.evidence,
    }


def add_report(imagery: AIM, name: str, report: dict[str, Any]) -> AIM:
    """Add what one kind of evidence says to the alignment report of imagery.

    Args:
        imagery: to be reported on.
        name: of the evidence, "aim" or "tracks".
        report: JSON.

    Returns:
        The imagery with the longer report.
    """
    before = imagery.report.get("alignment", {})
    return replace(imagery, report={**imagery.report, "alignment": {**before, name: report}})


def check_position(
    imagery: AIM, name: str, alignment: ImageryAlignment, bounds: Float[Array, "2 2"]
) -> AIM:
    """Check imagery that other evidence has placed, and warn where an alignment disagrees.

    Both agree when the mean squared Mahalanobis distance of the corners is below twice the 95 %
    quantile.

    Args:
        imagery: placed by control points or by an alignment; its report says how well.
        name: of the evidence that checks it.
        alignment: by that evidence.
        bounds: (2, 2) least and greatest x and y of the ground that the evidence covers.

    Returns:
        The imagery in its place, with the check in its report.
    """
    corners = np.clip(imagery.corners, *bounds)  # the evidence says nothing beyond
    offsets = transform_points(alignment.true_from_stated, corners) - corners
    covariance = _compute_covariance(alignment, corners) + _read_placement_covariance(imagery)
    squares = np.einsum("mi,mij,mj->m", offsets, np.linalg.inv(covariance), offsets)
    agrees = bool(squares.mean() < 2 * CHI2_2D)
    offset = float(np.linalg.norm(offsets, axis=1).max())
    uncertainty = float(np.sqrt(CHI2_2D * np.trace(covariance, axis1=1, axis2=2).max() / 2))
    if not agrees:
        east, north = alignment.shift
        warnings.warn(
            f"by the {name} the imagery's corners would lie up to {offset:.2f} m from where they "
            f"are placed, and its middle {east:.2f} m east and {north:.2f} m north, more than the "
            f"uncertainty of both, {uncertainty:.2f} m (95 %): is the {name} or what placed it "
            "wrong?",
            GeoaimWarning,
            stacklevel=3,
        )
    check = {"checked": True, "agrees": agrees}
    distances = {"corner_offset_m": offset, "corner_uncertainty_m": uncertainty}
    return add_report(imagery, name, report_alignment(alignment) | check | distances)


def _compute_covariance(
    alignment: ImageryAlignment, points: Float[Array, "m 2"]
) -> Float[Array, "m 2 2"]:
    """Covariance of points by an alignment, with that of its rotation where it is stated."""
    sigma = np.radians(alignment.evidence.get("rotation_sigma_degrees", 0.0))
    across = sigma * (points - alignment.center)[:, ::-1] * [-1.0, 1.0]
    return alignment.covariance + across[:, :, None] * across[:, None]


def _read_placement_covariance(imagery: AIM) -> Float[Array, "2 2"]:
    """Covariance of a point by what has placed the imagery, from its report."""
    report: Any = imagery.report
    if "georeference" in report:
        bounds = np.array(report["georeference"]["corner_uncertainty_m"])
        return np.eye(2) * np.mean(bounds**2) / CHI2_2D
    [placed] = [entry for entry in report["alignment"].values() if "checked" not in entry]
    return np.array(placed["covariance_m2"])
