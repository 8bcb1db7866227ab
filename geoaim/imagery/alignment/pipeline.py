"""The stages in order for third-party imagery: read it, correct its position, check it."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.files import open_aim, read_aim
from geoaim.aim.position import CHI2_2D, read_position_covariance, state_position
from geoaim.aim.rectification import change_aim_world, rectify
from geoaim.base.errors import AimError, AlignmentError, warn
from geoaim.base.files import MAP_FILE, find_in_folder
from geoaim.base.geometry import make_similarity, transform_points, translation
from geoaim.base.world import World, choose_world, lonlat_from_world
from geoaim.imagery.alignment.by_control_points import georeference_picture
from geoaim.imagery.alignment.evidence import (
    Evidence,
    apply_alignment,
    list_evidence,
    place_mosaic,
    report_alignment,
)
from geoaim.imagery.alignment.result import DEFAULT_PRIOR, ImageryAlignment, Prior
from geoaim.imagery.alignment.weighing import forget_undetermined_direction, weigh_alignment
from geoaim.imagery.mosaic import Mosaic, ReadOptions, read_lonlat, read_mosaic
from geoaim.imagery.sources import ImageryObject, Source
from geoaim.mapping.georeference.control_points import ControlPointSource
from geoaim.tracks.changes import to_world
from geoaim.tracks.tracks import Tracks

TRACK_MARGIN_M = 20.0  # distance from the tracks to the edges of the map
# a check whose evidence would change a standard deviation of the place by less moves nothing
MIN_GAIN = 0.1


class Shift(NamedTuple):
    """How far imagery is moved by hand: the middle of what is read, and a turn about it."""

    east: float  # metres
    north: float  # metres
    turn: float = 0.0  # radians, counter-clockwise


class AlignOptions(ReadOptions, total=False):
    """Options of `align_tiles`."""

    shift: Shift | None  # how far imagery is moved by hand, before any evidence
    keep_extent: bool
    output_crs: str | None
    similarity: bool


def align_tiles(
    tiles: Source | ImageryObject | Sequence[Source | ImageryObject],
    *,
    tracks: Tracks | None = None,
    aim: AIM | None = None,
    gcps: ControlPointSource | None = None,
    prior: Prior = DEFAULT_PRIOR,
    **options: Unpack[AlignOptions],
) -> AIM:
    """Read third-party imagery and correct its position.

    The strongest evidence places the imagery: control points, then an AIM of the same place, then
    tracks. The others check the place, with a warning where they disagree. Without any evidence
    the imagery stays where its georeference says, or where `shift` moves it by hand.

    A map that was built of a video keeps its pixels, its coverage and what its report knows.

    By an AIM the parts of a mosaic that lie at different places are moved each for itself. It
    counts by how well its own report says that its place is known: in a direction in which the
    imagery's georeference is better known, the imagery stays.

    Args:
        tiles: what `read_imagery` takes; with control points one picture, which needs no
            georeference.
        tracks: tracks of vehicles.
        aim: an AIM of the same place, from any day.
        gcps: what `read_control_points` takes: pixels of the picture and their coordinates.
        prior: how far off the imagery may be.
        options: those of `read_imagery` (`resolution`, `crs`, `bands`, `nodata`; the first two with
            control points too), and

            - `shift` (how far imagery is moved by hand, before any evidence),
            - `keep_extent` (True keeps all of the imagery; else it is cropped to the ground of the
              AIM or the tracks, and a margin),
            - `output_crs` (CRS of the map, projected and in metres; None: that of the evidence, or
              the UTM zone of the imagery),
            - `similarity` (with control points: True for a picture that is an orthophoto, free of
              tilt and distortion).

    Returns:
        The map, in the world of the AIM or else of the tracks; `report["alignment"]` has, by
        evidence ("aim", "tracks"), shift_m, uncertainty_m (95 %), undetermined_degrees, and parts
        where they were moved each for itself; `report["position"]` says how well the place is known
        relative to the evidence and in the world.

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
    world = None
    if (crs := options.get("output_crs")) is not None:
        if evidence := list_evidence(aim, tracks, prior):
            lonlat = lonlat_from_world(evidence[0].source.world, evidence[0].bounds)
        else:
            lonlat = read_lonlat(tiles, options.get("crs"))
        world = choose_world(lonlat, crs=crs)
        aim = None if aim is None else change_aim_world(aim, world)
        tracks = None if tracks is None else to_world(tracks, world)
    elif aim is not None and tracks is not None:
        tracks = to_world(tracks, aim.world)
    evidence = list_evidence(aim, tracks, prior)
    world = evidence[0].source.world if evidence else world
    if gcps is not None:
        imagery = _read_picture(tiles, gcps, world, options)
    else:
        mosaic = _read_mosaic(tiles, world, evidence, prior, options)
        imagery = mosaic.aim
        if evidence:
            imagery = _forget_georeference(place_mosaic(mosaic, evidence.pop(0)))
    for other in evidence:
        imagery = _check(imagery, other)
    return imagery


def _read_mosaic(
    tiles: Source | ImageryObject | Sequence[Source | ImageryObject],
    world: World | None,
    evidence: Sequence[Evidence],
    prior: Prior,
    options: AlignOptions,
) -> Mosaic:
    """Read the ground of the evidence, or all, and move it by hand as the options say."""
    if options.get("similarity"):
        raise ValueError("`similarity` needs control points")
    shift = options.get("shift")
    corners = None if options.get("keep_extent") else _choose_region(evidence, prior, shift)
    names = ReadOptions.__annotations__
    read: Any = {name: value for name, value in options.items() if name in names}
    mosaic = _read_built(tiles, world, read)
    if mosaic is None:
        mosaic = read_mosaic(tiles, world=world, corners=corners, **read)
    return mosaic if shift is None else mosaic._replace(aim=_move_by_hand(mosaic, shift))


def _read_built(
    tiles: Source | ImageryObject | Sequence[Source | ImageryObject],
    world: World | None,
    options: ReadOptions,
) -> Mosaic | None:
    """Read a map that was built of a video as it is, with its coverage, doubt and report."""
    if not isinstance(tiles, str | os.PathLike) or any(options.values()):
        return None
    path = find_in_folder(tiles, MAP_FILE)
    if path.suffix.lower() not in (".tif", ".tiff") or not path.is_file():
        return None
    try:
        with open_aim(path) as file:
            is_built = "background" in file.report
    except AimError:
        return None  # imagery
    if not is_built:
        return None
    aim = read_aim(path)
    return Mosaic(aim if world is None else change_aim_world(aim, world), None, (path.name,))


def _forget_georeference(imagery: AIM) -> AIM:
    """Keep what placed a built map before it was aligned as history only."""
    if "georeference" not in imagery.report or "background" not in imagery.report:
        return imagery
    report = dict(imagery.report)
    earlier = {"georeference": report.pop("georeference")}
    return replace(imagery, report={**report, "before_alignment": earlier})


def _read_picture(
    tiles: Source | ImageryObject | Sequence[Source | ImageryObject],
    gcps: ControlPointSource,
    world: World | None,
    options: AlignOptions,
) -> AIM:
    if not isinstance(tiles, str | os.PathLike):
        raise ValueError("control points are pixels of one image; give one file")
    others = [name for name in ("bands", "nodata", "shift", "keep_extent") if options.get(name)]
    if others:
        raise ValueError(f"control points place the whole picture as it is: omit {others[0]}")
    picture = georeference_picture(
        Path(tiles),
        gcps,
        world=world,
        crs=options.get("crs"),
        similarity=options.get("similarity", False),
    )
    resolution = options.get("resolution")
    return picture if resolution is None else rectify(picture, resolution)


def _choose_region(
    evidence: Sequence[Evidence], prior: Prior, shift: Shift | None
) -> Float[Array, "n 2"] | None:
    """Corners to read: the evidence's ground, and what may be moved into it; None without any."""
    if not evidence:
        return None
    source = evidence[0].source
    margin = prior.max_shift + (TRACK_MARGIN_M if isinstance(source, Tracks) else 0.0)
    if shift is not None:
        margin += float(np.hypot(shift.east, shift.north))
    return evidence[0].bounds + np.array([[-margin], [margin]])


def _move_by_hand(mosaic: Mosaic, shift: Shift) -> AIM:
    """Move a mosaic by hand, and report it."""
    imagery = mosaic.aim
    turn = make_similarity(imagery.corners.mean(axis=0), shift.turn, 1.0)
    matrix = translation(shift.east, shift.north) @ turn @ imagery.world_from_image
    by_hand = {"shift_m": [shift.east, shift.north], "turn_degrees": float(np.degrees(shift.turn))}
    kept = {name: value for name, value in imagery.report.items() if name != "place"}
    report = {**kept, "moved_by_hand": by_hand, "position": state_position("shift by hand", None)}
    return replace(imagery, world_from_image=matrix, report=report)


def _check(imagery: AIM, evidence: Evidence) -> AIM:
    try:
        alignment = evidence.align(imagery)
    except AlignmentError as error:
        message = f"the {evidence.name} could not check the place: {error}"
        warn(message)
        return _add_report(imagery, evidence.name, {"checked": False, "reason": str(error)})
    checked = _check_position(imagery, evidence, alignment)
    agrees = checked.report["alignment"][evidence.name]["agrees"]
    return _add_weight(checked, evidence, alignment) if agrees else checked


def _add_weight(imagery: AIM, evidence: Evidence, alignment: ImageryAlignment) -> AIM:
    """Move imagery by the weight of evidence that agrees, where this makes its place surer."""
    own = read_position_covariance(imagery.report)
    if own is None or "georeference" in imagery.report:
        return imagery  # control points were picked for this picture, and hold
    none = np.zeros((2, 2))
    reference = none if evidence.covariance is None else evidence.covariance
    moved, covariance = weigh_alignment(forget_undetermined_direction(alignment), own, reference)
    if np.sqrt(np.linalg.eigvals(np.linalg.solve(own, covariance)).real.min()) > 1 - MIN_GAIN:
        return imagery
    moved = replace(moved, true_from_stated=translation(*moved.shift))
    position = {**imagery.report["position"], "covariance_m2": covariance}
    entries = imagery.report["alignment"] | {
        evidence.name: imagery.report["alignment"][evidence.name] | {"moved_m": moved.shift}
    }
    report = {**imagery.report, "position": position, "alignment": entries}
    del report["place"]
    return replace(apply_alignment(imagery, moved), report=report)


def _add_report(imagery: AIM, name: str, report: dict[str, Any]) -> AIM:
    """Add what one kind of evidence says to the alignment report of imagery."""
    before = imagery.report.get("alignment", {})
    return replace(imagery, report={**imagery.report, "alignment": {**before, name: report}})


def _check_position(imagery: AIM, evidence: Evidence, alignment: ImageryAlignment) -> AIM:
    """Check the place of imagery within the bounds of evidence, and warn where both differ."""
    name = evidence.name
    corners = np.clip(imagery.corners, *evidence.bounds)  # the evidence says nothing beyond
    offsets = transform_points(alignment.true_from_stated, corners) - corners
    covariance = _compute_covariance(alignment, corners) + _read_placement_covariance(imagery)
    if evidence.covariance is not None:
        covariance = covariance + evidence.covariance
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
    return _add_report(imagery, name, report_alignment(alignment) | check | distances)


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
    return np.array(report["position"]["covariance_m2"])
