"""The report of a placement: how imagery was moved, and how well its place is known."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim.position import state_position
from geoaim.base.geometry import transform_points
from geoaim.imagery.alignment.evidence import AimEvidence, Evidence
from geoaim.imagery.alignment.parts import Part
from geoaim.imagery.alignment.result import ImageryAlignment

MAX_RESIDUALS = 400  # windows whose residuals are in the report


class PlacedPart(NamedTuple):
    """A part, how it is moved in the end, and how well its place in the world is then known."""

    part: Part
    moved: ImageryAlignment
    covariance: Float[Array, "2 2"]


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


def report_position(placed: list[PlacedPart], evidence: Evidence) -> dict[str, Any]:
    """The entry "position" of the report, for the part that is known least."""
    worst = max(placed, key=lambda one: np.trace(one.covariance))
    relative = max((one.part.alignment.covariance for one in placed), key=np.trace)
    entry = state_position(
        evidence.name, worst.covariance, relative_to=evidence.name, relative=relative
    )
    assumed = [] if evidence.covariance is not None else [evidence.name]
    if isinstance(evidence, AimEvidence):
        assumed += evidence.source.report.get("position", {}).get("assumes", [])
    offset = worst.part.alignment.shift - worst.moved.shift
    return entry | {"assumes": assumed, "offset_from_reference_m": offset}


def report_parts(placed: list[PlacedPart]) -> dict[str, Any]:
    """The alignment of the largest part, and of each part where there are several."""
    report = report_alignment(placed[0].part.alignment)
    report["true_from_stated"] = placed[0].moved.true_from_stated
    rows = [(number, one.part.alignment) for number, one in enumerate(placed)]
    windows = [
        np.column_stack([np.full(len(alignment.windows), number), alignment.windows])
        for number, alignment in rows
        if alignment.windows is not None
    ]
    if windows:
        residuals = np.concatenate(windows)
        report["residuals"] = residuals[:: len(residuals) // MAX_RESIDUALS + 1].round(3)
    if len(placed) > 1:
        total = sum(one.part.mask.sum() for one in placed)
        report["parts"] = [
            {
                **report_alignment(one.part.alignment),
                "name": one.part.name,
                "aligned": one.part.placed,
                "share": float(one.part.mask.sum() / total),
                "world_covariance_m2": one.covariance,
                "true_from_stated": one.moved.true_from_stated,
            }
            for one in placed
        ]
    return report
