"""The report of an AIM in a dozen short lines."""

from collections.abc import Mapping
from textwrap import shorten
from typing import Any

import numpy as np

MAX_REASON_CHARS = 70
Lines = dict[str, str]


def summarize_report(report: Mapping[str, Any]) -> Lines:
    """Summarize the report of an AIM: how it was made and how accurate it is.

    Returns:
        For each name, a value with its unit as text, such as "worst corner": "top left of the
        frame, 0.40 m"; in the order of the stages. Stages that the report lacks are left out.
    """
    lines: Lines = {}
    if registration := report.get("registration"):
        lines["motion model"] = registration["model"]
        lines["registered frames"] = f"{registration['valid']} of {registration['frames']}"
        lines["registration"] = f"{registration['uncertainty_px']:.3f} px (1 sigma, corners)"
    if background := report.get("background"):
        lines["background"] = f"{background['method']} of {background['frames_used']} frames"
        lines["contested"] = f"{background['contested_share']:.2%} of the pixels"
    if georeference := report.get("georeference"):
        lines |= _summarize_georeference(georeference)
    alignments = report.get("alignment", {})
    placed = "georeference" in report or any("checked" not in one for one in alignments.values())
    if report.get("source") == "imagery" and not placed:
        lines["position"] = "not aligned: as the georeference of the imagery says"
    for evidence, alignment in alignments.items():
        if "checked" in alignment:
            lines[f"check by {evidence}"] = _summarize_check(alignment)
        else:
            lines |= _summarize_alignment(evidence, alignment)
    return lines


def _summarize_georeference(georeference: Mapping[str, Any]) -> Lines:
    approximate = "approximate, " if georeference["approximate"] else ""
    lines = {"georeference": approximate + georeference["model"]}
    if uncertainty := georeference.get("uncertainty"):
        lines["uncertainty (95 %)"] = (
            f"{uncertainty['middle_m']:.2f} m in the middle, median {uncertainty['median_m']:.2f} m"
        )
        lines["worst corner"] = (
            f"{uncertainty['worst_corner']} of the frame, {uncertainty['worst_corner_m']:.2f} m; "
            f"with a point there {uncertainty['worst_corner_with_point_there_m']:.2f} m"
        )
    else:  # a report of version 0.1
        bound = max(georeference["corner_uncertainty_m"])
        lines["corner uncertainty"] = f"{bound:.2f} m (95 %)"
    if georeference["points"]:
        errors = [point["leave_one_out_m"] for point in georeference["points"] if point["used"]]
        rms = np.sqrt(np.mean(np.square(errors)))
        lines["leave-one-out error"] = f"{rms:.4f} m (RMS of {len(errors)} points)"
    return lines


def _summarize_alignment(evidence: str, alignment: Mapping[str, Any]) -> Lines:
    east, north = alignment["shift_m"]
    line = (
        f"{alignment['model']}, {east:+.2f} m east, {north:+.2f} m north, "
        f"{alignment['rotation_degrees']:+.2f} degrees; {alignment['uncertainty_m']:.2f} m (95 %)"
    )
    lines = {f"alignment by {evidence}": line}
    direction = alignment["undetermined_degrees"]
    if direction is not None:
        lines["undetermined"] = f"along {direction % 180:.0f} degrees"
    return lines


def _summarize_check(check: Mapping[str, Any]) -> str:
    """Summarize what one evidence says about an alignment by another."""
    if not check["checked"]:
        return f"not possible: {shorten(check['reason'], MAX_REASON_CHARS, placeholder=' ...')}"
    verdict = "agrees" if check["agrees"] else "DISAGREES"
    off, uncertainty = check["corner_offset_m"], check["corner_uncertainty_m"]
    return f"{verdict}: corners {off:.2f} m off, uncertainty {uncertainty:.2f} m (95 %)"
