"""The report of an AIM: the results of each stage as JSON values, stored in its file."""

from typing import Any

import numpy as np

from geoaim.aim.position import state_position
from geoaim.base.geometry import image_corners, transform_points
from geoaim.mapping.background.running_mean import Background
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.georeference import Georeference, world_from_pixels
from geoaim.mapping.georeference.uncertainty import (
    average_covariance,
    map_uncertainty,
    predict_uncertainty,
)
from geoaim.mapping.registration.register import Registration, count_reasons

UNDETECTED = (  # what no method knows from the frames alone
    "what stands in every frame is shown as ground and is not contested; boxes, a longer clip, "
    "another flight or imagery would tell"
)


def report_registration(registration: Registration) -> dict[str, Any]:
    """Report the motion model, counts of frames and of reasons, and the camera's drift, by name."""
    reference, valid = registration.reference, registration.valid
    middle = np.array([[reference.width / 2, reference.height / 2]])
    path = transform_points(registration.reference_from_frame[valid], middle)[:, 0]
    path = np.column_stack([registration.time[valid], path])
    thinned = path[:: len(path) // 1000 + 1]  # 1000 points at most
    return {
        "model": reference.model,
        "predicted_error_px": dict(reference.choice.predicted_error) if reference.choice else {},
        "reference_index": int(reference.index),
        "reference_time_s": float(reference.time),
        "frames": len(valid),
        "valid": int(valid.sum()),
        "rejected": count_reasons(registration.reason),
        "uncertainty_px": float(np.median(registration.uncertainty[valid])),
        "inlier_share": float(np.median(registration.inlier_share[valid])),
        "path": thinned.round(3).tolist(),
    }


def report_georeference(georeference: Georeference, points: ControlPoints | None) -> dict[str, Any]:
    """Report the transform model, each control point's residuals, and the uncertainty, by name.

    A local map by a given scale has no uncertainty: nothing says how far off that scale is.
    """
    given_scale = georeference.world.crs is None and not len(georeference.pixels)
    corners = image_corners(georeference.height, georeference.width)
    sigma, bound = predict_uncertainty(georeference, corners)
    rows = []
    if points is not None:
        fitted = world_from_pixels(georeference, points.pixels)
        given = fitted - georeference.residuals
        rows = [
            {
                "name": points.names[i],
                "u": points.pixels[i, 0],
                "v": points.pixels[i, 1],
                "x": given[i, 0],
                "y": given[i, 1],
                "residual_x": georeference.residuals[i, 0],
                "residual_y": georeference.residuals[i, 1],
                "leave_one_out_m": georeference.leave_one_out[i],
                "used": bool(georeference.used[i]),
            }
            for i in range(len(given))
        ]
    return {
        "model": georeference.model,
        "approximate": georeference.approximate,
        "radial": georeference.radial,
        "noise_m": georeference.noise,
        "datum_accuracy_m": georeference.datum_accuracy,
        "probability_by_model": dict(georeference.probabilities),
        "corner_sigma_m": sigma,
        "corner_uncertainty_m": bound,
        "given_scale": given_scale,
        "uncertainty": None if given_scale else map_uncertainty(georeference),
        "points": rows,
    }


def report_position(georeference: Georeference, points: ControlPoints | None) -> dict[str, Any]:
    """Report how well a georeference places a map: what it adds to what its points share."""
    if georeference.approximate:
        return state_position("telemetry", average_covariance(georeference))
    covariance = average_covariance(georeference)
    if points is None or points.shared_covariance is None:
        return state_position("control points", covariance)
    return state_position(
        "control points",
        covariance + points.shared_covariance,
        relative_to="imagery",
        relative=covariance,
    )


def report_background(background: Background, method: str) -> dict[str, Any]:
    """Report the method, frames in the mean, and contested pixels, by name."""
    seen = background.coverage > 0
    return {
        "method": method,
        "frames_used": background.frames_used,
        "contested_share": float(background.contested.mean()),
        "contested_pixels": int(background.contested.sum()),
        "undetected": UNDETECTED,
        "unseen_share": float(1 - (seen | background.contested).mean()),
        "gain_range": [float(background.gains.min()), float(background.gains.max())],
    }
