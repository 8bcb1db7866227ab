"""The stages in order for third-party imagery: read it, correct its position, check it."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.rectification import rectify
from geoaim.base.errors import AlignmentError, TracksError, warn
from geoaim.base.geometry import transform_points
from geoaim.base.world import World
from geoaim.imagery.alignment.by_control_points import georeference_picture
from geoaim.imagery.alignment.by_image import align_image
from geoaim.imagery.alignment.by_tracks import align_tracks
from geoaim.imagery.alignment.prior import DEFAULT_PRIOR, Prior
from geoaim.imagery.alignment.result import CHI2_2D, ImageryAlignment
from geoaim.imagery.mosaic import read_imagery
from geoaim.imagery.sources import Source
from geoaim.mapping.georeference.control_points import ControlPointSource
from geoaim.tracks.changes import to_world
from geoaim.tracks.tracks import Tracks

TRACK_MARGIN_M = 20.0  # distance from the tracks to the edges of the map


class _ReadOptions(TypedDict, total=False):
    """Options of `align_tiles` for reading imagery."""

    # metres per pixel; with control points the picture is resampled north up
    resolution: float | None
    crs: str | None  # CRS of imagery or of control points that name none
    # numbers of the grey band, or of the red, green and blue ones, from 1
    bands: Sequence[int] | None


class _Evidence(NamedTuple):
    """Evidence of where imagery lies: its name, the AIM or tracks, and how to align to it."""

    name: str
    source: AIM | Tracks
    align: Callable[[AIM], ImageryAlignment]


def align_tiles(
    tiles: Source | Sequence[Source],
    *,
    tracks: Tracks | None = None,
    aim: AIM | None = None,
    gcps: ControlPointSource | None = None,
    prior: Prior = DEFAULT_PRIOR,
    **options: Unpack[_ReadOptions],
) -> AIM:
    """Read third-party imagery and correct its position.

    The strongest evidence places the imagery: control points, then an AIM of the same place, then
    tracks. The others check the place, with a warning where they disagree. Without any evidence
    the imagery stays where its georeference says.

    Args:
        tiles: what `read_imagery` takes; with control points one picture, which needs no
            georeference.
        tracks: tracks of vehicles.
        aim: an AIM of the same place, from any day.
        gcps: what `read_control_points` takes: pixels of the picture and their coordinates.
        prior: how far off the imagery may be.
        options: `resolution` (metres per pixel; None: that of the imagery), `crs` (of imagery or
            control points that name none) and `bands` (see `read_imagery`; not with `gcps`).

    Returns:
        The map, in the world of the AIM or else of the tracks; `report["alignment"]` has, by
        evidence ("aim", "tracks"), shift_m, uncertainty_m (95 %), undetermined_degrees, ...

    Raises:
        FileNotFoundError: `tiles` names no file.
        ImageryError: the imagery cannot be read, or lies elsewhere.
        TracksError: the tracks that should place it have no agents.
        AlignmentError: the evidence does not fix the place, or fits in two ways.
        GeoreferenceError: the control points do not fix a place.
        ValueError: no source is given, or control points with several sources.

    >>> align_tiles([])
    Traceback (most recent call last):
        ...
    ValueError: no source of imagery was given: name at least one
    """
    if aim is not None and tracks is not None:
        tracks = to_world(tracks, aim.world)
    evidence = _list_evidence(aim, tracks, prior)
    if gcps is not None:
        world = evidence[0].source.world if evidence else None
        imagery = _read_picture(tiles, gcps, world, options)
    else:
        world, corners = _choose_region(evidence, prior)
        imagery = read_imagery(tiles, world=world, corners=corners, **options)
        if evidence:
            imagery = _move(imagery, evidence.pop(0))
    for other in evidence:
        imagery = _check(imagery, other)
    return imagery


def _list_evidence(aim: AIM | None, tracks: Tracks | None, prior: Prior) -> list[_Evidence]:
    """What is given, the strongest first."""
    evidence = []
    if aim is not None:
        evidence.append(_Evidence("aim", aim, lambda x: align_image(x, aim, prior=prior)))
    if tracks is not None:
        evidence.append(_Evidence("tracks", tracks, lambda x: align_tracks(x, tracks, prior=prior)))
    return evidence


def _read_picture(
    tiles: Source | Sequence[Source],
    gcps: ControlPointSource,
    world: World | None,
    options: _ReadOptions,
) -> AIM:
    if not isinstance(tiles, str | os.PathLike):
        raise ValueError("control points are pixels of one image; give one file")
    if "bands" in options:
        raise TypeError("`bands` cannot be combined with `gcps`")
    picture = georeference_picture(Path(tiles), gcps, world=world, crs=options.get("crs"))
    resolution = options.get("resolution")
    return picture if resolution is None else rectify(picture, resolution)


def _choose_region(
    evidence: list[_Evidence], prior: Prior
) -> tuple[World | None, Float[Array, "n 2"] | None]:
    """World and corners to read: the evidence's ground, and what may be moved into it."""
    if not evidence:
        return None, None
    source = evidence[0].source
    margin = prior.max_shift + (TRACK_MARGIN_M if isinstance(source, Tracks) else 0.0)
    return source.world, _find_bounds(source) + np.array([[-margin], [margin]])


def _find_bounds(source: AIM | Tracks) -> Float[Array, "2 2"]:
    """Least and greatest x and y of the ground that evidence covers."""
    points = source.corners if isinstance(source, AIM) else source.states[source.present][:, :2]
    if not len(points):
        raise TracksError("no agent is present in the tracks at any time; give others, or none")
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _move(imagery: AIM, evidence: _Evidence) -> AIM:
    alignment = evidence.align(imagery)
    direction = alignment.undetermined_direction
    if direction is not None:
        sigma = float(np.sqrt(np.linalg.eigvalsh(alignment.covariance)[1]))
        warn(
            f"along {np.degrees(direction) % 180:.0f} degrees from east the place is known by the "
            f"{evidence.name} to {sigma:.1f} m only (one sigma), as nothing changes along straight "
            "roads: in this direction the imagery stays where its georeference says"
        )
    return _add_report(
        apply_alignment(imagery, alignment), evidence.name, _report_alignment(alignment)
    )


def _check(imagery: AIM, evidence: _Evidence) -> AIM:
    try:
        alignment = evidence.align(imagery)
    except AlignmentError as error:
        message = f"the {evidence.name} could not check the place: {error}"
        warn(message)
        return _add_report(imagery, evidence.name, {"checked": False, "reason": str(error)})
    return _check_position(imagery, evidence.name, alignment, _find_bounds(evidence.source))


def apply_alignment(imagery: AIM, alignment: ImageryAlignment) -> AIM:
    """Move imagery to where an alignment places it; its pixels stay as they are."""
    return replace(imagery, world_from_image=alignment.true_from_stated @ imagery.world_from_image)


def _report_alignment(alignment: ImageryAlignment) -> dict[str, Any]:
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


def _add_report(imagery: AIM, name: str, report: dict[str, Any]) -> AIM:
    """Add what one kind of evidence says to the alignment report of imagery."""
    before = imagery.report.get("alignment", {})
    return replace(imagery, report={**imagery.report, "alignment": {**before, name: report}})


def _check_position(
    imagery: AIM, name: str, alignment: ImageryAlignment, bounds: Float[Array, "2 2"]
) -> AIM:
    """Check the place of imagery within the bounds of evidence, and warn where both differ."""
    corners = np.clip(imagery.corners, *bounds)  # the evidence says nothing beyond
    offsets = transform_points(alignment.true_from_stated, corners) - corners
    covariance = _compute_covariance(alignment, corners) + _read_placement_covariance(imagery)
    squares = np.einsum("mi,mij,mj->m", offsets, np.linalg.inv(covariance), offsets)
    agrees = bool(squares.mean() < 2 * CHI2_2D)  # mean squared Mahalanobis distance
    offset = float(np.linalg.norm(offsets, axis=1).max())
    uncertainty = float(np.sqrt(CHI2_2D * np.trace(covariance, axis1=1, axis2=2).max() / 2))
    if not agrees:
        east, north = alignment.shift
        warn(
            f"by the {name} the imagery's corners would lie up to {offset:.2f} m from where they "
            f"are placed, and its middle {east:.2f} m east and {north:.2f} m north, more than the "
            f"uncertainty of both, {uncertainty:.2f} m (95 %): is the {name} or what placed it "
            "wrong?"
        )
    check = {"checked": True, "agrees": agrees}
    distances = {"corner_offset_m": offset, "corner_uncertainty_m": uncertainty}
    return _add_report(imagery, name, _report_alignment(alignment) | check | distances)


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
