"""The report of an AIM in a dozen short lines."""

from collections.abc import Mapping, Sequence
from textwrap import shorten
from typing import Any

import numpy as np

from geoaim.aim.position import MOVED, describe_covariance, measure_azimuth

MAX_NAME_CHARS = 24  # of a file, of which the end tells most
MIN_OFFSET_M = 0.1  # imagery that stays farther from where its reference shows it says so
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
        lines["registration"] = f"{registration['uncertainty_px']:.3f} px (1 sigma, over the image)"
    if background := report.get("background"):
        lines["background"] = f"{background['method']} of {background['frames_used']} frames"
        lines["contested"] = _summarize_contested(background)
    if georeference := report.get("georeference"):
        lines |= _summarize_georeference(georeference)
    alignments = report.get("alignment", {})
    placed = "georeference" in report or any("checked" not in one for one in alignments.values())
    position = report.get("position", {})
    if position.get("source") == MOVED:
        lines["position"] = f"{MOVED}: how well it lies is unknown"
    elif by_hand := report.get("moved_by_hand"):
        moved = _summarize_shift(by_hand["shift_m"], by_hand["turn_degrees"])
        lines["position"] = f"moved by hand: {moved}"
    elif report.get("source") == "imagery" and not placed:
        lines["position"] = "not aligned: as the georeference of the imagery says"
    for evidence, alignment in alignments.items():
        if "checked" in alignment:
            lines[f"check by {evidence}"] = _summarize_check(alignment)
        else:
            lines |= _summarize_alignment(evidence, alignment)
            if not position:  # a report of version 0.1
                covariance = _describe(alignment["covariance_m2"])
                lines["uncertainty (95 %)"] = covariance
    return lines | _summarize_position(position)


def _summarize_contested(background: Mapping[str, Any]) -> str:
    share = background["contested_share"]
    if background["method"] == "mean" and share == 0:
        return "not looked for: this is a mean with its traffic"
    return f"{share:.2%} of the pixels, whose ground the frames do not determine"


def format_metres(length: float) -> str:
    """Format a length to the centimetre, and nothing finer.

    >>> format_metres(0.004), format_metres(0.31)
    ('under 1 cm', '0.31 m')
    """
    return "under 1 cm" if length < 0.01 else f"{length:.2f} m"


def _summarize_georeference(georeference: Mapping[str, Any]) -> Lines:
    approximate = "approximate, " if georeference["approximate"] else ""
    lines = {"georeference": approximate + georeference["model"]}
    if georeference.get("given_scale"):
        lines["scale"] = "as given; nothing in the frames checks it"
        if proposed := georeference.get("scale_by_vehicles"):
            lines["scale"] = (
                f"proposed by {proposed['vehicles']} vehicles, to {proposed['sigma']:.0%} (1 sigma)"
            )
    elif uncertainty := georeference.get("uncertainty"):
        lines["uncertainty (95 %)"] = (
            f"{format_metres(uncertainty['middle_m'])} in the middle, "
            f"median {format_metres(uncertainty['median_m'])}"
        )
        lines["worst corner"] = (
            f"{uncertainty['worst_corner']} of the frame, "
            f"{format_metres(uncertainty['worst_corner_m'])}"
        )
        if not georeference["approximate"]:  # telemetry's error is one of place, not of a corner
            with_point = format_metres(uncertainty["worst_corner_with_point_there_m"])
            lines["worst corner"] += f"; with a point there {with_point}"
    else:  # a report of version 0.1
        bound = max(georeference["corner_uncertainty_m"])
        lines["corner uncertainty"] = f"{format_metres(bound)} (95 %)"
    if georeference["points"]:
        errors = [point["leave_one_out_m"] for point in georeference["points"] if point["used"]]
        rms = np.sqrt(np.mean(np.square(errors)))
        lines["leave-one-out error"] = f"{rms:.4f} m (RMS of {len(errors)} points)"
    return lines


def _summarize_alignment(evidence: str, alignment: Mapping[str, Any]) -> Lines:
    shift = _summarize_shift(alignment["shift_m"], alignment["rotation_degrees"])
    line = f"{alignment['model']}, {shift}"
    lines = {}
    for part in alignment.get("parts", []):
        line = "each part for itself"
        covariance = _describe(part["covariance_m2"])
        shift = _summarize_shift(part["shift_m"], part["rotation_degrees"])
        how = "" if part["aligned"] else ", as the others on average"
        lines[f"part {part['name'].removeprefix('part ')}"] = f"{shift}{how}; {covariance} (95 %)"
    lines = {f"alignment by {evidence}": line, **lines}
    direction = alignment["undetermined_degrees"]
    if direction is not None:
        along = np.array([np.cos(np.radians(direction)), np.sin(np.radians(direction))])
        lines["undetermined"] = (
            f"along azimuth {measure_azimuth(along):.0f}°, where only --max-shift limits it"
        )
    return lines


def _summarize_shift(shift: Sequence[float], degrees: float) -> str:
    east, north = shift
    return f"{east:+.2f} m east, {north:+.2f} m north, {degrees:+.2f} degrees"


def _summarize_position(position: Mapping[str, Any]) -> Lines:
    """Summarize how well the place is known, relative to a reference and in the world."""
    if "relative_to" not in position:
        return {}
    name = position.get("reference") or f"the {position['relative_to']}"
    name = name if len(name) <= MAX_NAME_CHARS else f"...{name[3 - MAX_NAME_CHARS :]}"
    relative = _describe(position["relative_covariance_m2"])
    offset = position.get("offset_from_reference_m", [0.0, 0.0])
    if (distance := float(np.hypot(*offset))) > MIN_OFFSET_M:
        azimuth = float(np.degrees(np.arctan2(*offset))) % 360
        relative += f"; {name} shows it {distance:.2f} m away at azimuth {azimuth:.0f}°"
    lines = {f"relative to {name} (95 %)": relative}
    in_world = _describe(position["covariance_m2"])
    if assumed := position.get("assumes"):
        in_world += f", taking the {' and the '.join(assumed)} as right"
    if supposed := position.get("supposed_accuracy_m"):
        in_world += f", supposing {supposed} m (1 sigma) of the imagery's own place"
    return lines | {"in the world (95 %)": in_world}


def _describe(covariance: Sequence[Sequence[float]] | None) -> str:
    return describe_covariance(None if covariance is None else np.array(covariance, float))


def _summarize_check(check: Mapping[str, Any]) -> str:
    """Summarize what one evidence says about an alignment by another."""
    if not check["checked"]:
        return f"not possible: {shorten(check['reason'], 70, placeholder=' ...')}"
    verdict = "agrees" if check["agrees"] else "DISAGREES"
    direction = check.get("undetermined_degrees")
    if direction is not None:  # along a straight road nothing is checked
        across = np.array([-np.sin(np.radians(direction)), np.cos(np.radians(direction))])
        verdict += f" at azimuth {measure_azimuth(across):.0f}°, nothing is told along the road"
    off, uncertainty = check["corner_offset_m"], check["corner_uncertainty_m"]
    return f"{verdict}: corners {off:.2f} m off, uncertainty {uncertainty:.2f} m (95 %)"
