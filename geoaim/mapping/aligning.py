"""The stages in order for imagery of others: reading -> evidence of its place -> AIM."""

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.errors import AlignmentError, GeoaimWarning
from geoaim.mapping.alignment import CHI2, PRIOR, Alignment, Prior, moved, report_alignment
from geoaim.mapping.control_points import read_control_points
from geoaim.mapping.georeference import georeference
from geoaim.mapping.image_evidence import align_image
from geoaim.mapping.report import report_georeference
from geoaim.mapping.sources import Source
from geoaim.mapping.tiles import read_imagery
from geoaim.mapping.track_evidence import align_tracks
from geoaim.mapping.video import open_video
from geoaim.track_changes import tracks_in
from geoaim.tracks import Tracks
from geoaim.world import World

MARGIN = 20.0  # m around tracks that the map shows
Align = Callable[[AIM], Alignment]


def align_tiles(
    tiles: Source | Sequence[Source],
    *,
    tracks: Tracks | None = None,
    aim: AIM | None = None,
    gcps: Any = None,
    resolution: float | None = None,
    crs: str | None = None,
    prior: Prior = PRIOR,
) -> AIM:
    """An AIM of imagery that others took: orthophotos, tiles, a tile service, a picture.

    The strongest evidence places it, and the others check that, with a warning where they
    disagree: control points, then an AIM of the same place, then tracks. Without any it stays
    where it says to lie.

    Args:
        tiles: what `read_imagery` takes; with control points one picture, which need not say
            where it lies.
        tracks: of vehicles.
        aim: of the same place, of any other day.
        gcps: what `read_control_points` takes: pixels of the picture and their places.
        resolution: metres a pixel; the imagery's own when None.
        crs: of imagery that names none.
        prior: how far off the imagery may be.

    Returns:
        The map, in the world of the AIM or else of the tracks; its report says how well its
        place is known, and in which direction it is not.

    Raises:
        ImageryError: the imagery cannot be read, or is elsewhere.
        AlignmentError: the evidence does not tell where it lies, or fits in two ways.
        GeoreferenceError: the control points do not fix a place.
        ValueError: a call that cannot be.

    >>> align_tiles([])
    Traceback (most recent call last):
        ...
    ValueError: no source of imagery was given: name at least one
    """
    if aim is not None and tracks is not None:
        tracks = tracks_in(tracks, aim.world)
    if gcps is not None:
        imagery, placed = _by_control_points(tiles, gcps, aim, tracks), True
    else:
        world, corners = _wanted(aim, tracks, prior)
        imagery = read_imagery(tiles, world=world, corners=corners, resolution=resolution, crs=crs)
        placed = False
    for name, align in _evidence(aim, tracks, prior):
        if placed:
            imagery = _checked(imagery, name, align)
        else:
            found = align(imagery)
            imagery = _with_report(moved(imagery, found), name, report_alignment(found))
            _warn_of_direction(found)
            placed = True
    return imagery


def _evidence(aim: AIM | None, tracks: Tracks | None, prior: Prior) -> list[tuple[str, Align]]:
    """What is given, from the strongest on."""
    found: list[tuple[str, Align]] = []
    if aim is not None:
        found.append(("aim", lambda imagery: align_image(imagery, aim, prior=prior)))
    if tracks is not None:
        found.append(("tracks", lambda imagery: align_tracks(imagery, tracks, prior=prior)))
    return found


def _wanted(
    aim: AIM | None, tracks: Tracks | None, prior: Prior
) -> tuple[World | None, Float[Array, "n 2"] | None]:
    """The world and ground to read, with what may be moved into it."""
    if aim is not None:
        world, places, margin = aim.world, aim.corners, prior.reach
    elif tracks is not None:
        world, places = tracks.world, tracks.states[tracks.present][:, :2]
        margin = MARGIN + prior.reach
    else:
        return None, None
    low, high = places.min(axis=0) - margin, places.max(axis=0) + margin
    return world, np.stack([low, high])


def _by_control_points(
    tiles: Source | Sequence[Source], gcps: Any, aim: AIM | None, tracks: Tracks | None
) -> AIM:
    """One picture where control points lay it."""
    if not isinstance(tiles, str | os.PathLike):
        raise ValueError("control points are pixels of one picture; give one file")
    [image, *others] = [frame.image for frame in open_video(str(tiles))]
    if others:
        raise ValueError(f"{tiles} holds {1 + len(others)} pictures; control points are of one")
    points = read_control_points(gcps)
    height, width = image.shape[:2]
    world = next((given.world for given in (aim, tracks) if given is not None), None)
    place = georeference(points, height=height, width=width, world=world)
    return AIM(
        image=image,
        world_from_image=place.world_from_image,
        world=place.world,
        coverage=np.ones((height, width), np.uint16),
        contested=np.zeros((height, width), bool),
        report={"source": str(tiles), "georeference": report_georeference(place, points)},
    )


def _checked(imagery: AIM, name: str, align: Align) -> AIM:
    """The imagery as it is placed, with what other evidence says of it."""
    try:
        found = align(imagery)
    except AlignmentError as error:
        _warn(f"the {name} could not check the place: {error}")
        return _with_report(imagery, name, {"checked": False, "why": str(error)})
    apart = float(found.shift @ np.linalg.solve(found.covariance, found.shift))
    report = report_alignment(found) | {"checked": True, "agrees": apart < 2 * CHI2}
    if apart >= 2 * CHI2:
        east, north = found.shift
        _warn(
            f"by the {name} the imagery would lie {east:.2f} m east and {north:.2f} m north of "
            f"where it is placed, more than their uncertainty of {found.uncertainty:.2f} m"
        )
    return _with_report(imagery, name, report)


def _with_report(imagery: AIM, name: str, report: dict[str, Any]) -> AIM:
    before = imagery.report.get("alignment", {})
    return replace(imagery, report={**imagery.report, "alignment": {**before, name: report}})


def _warn_of_direction(found: Alignment) -> None:
    direction = found.undetermined
    if direction is not None:
        worst = float(np.sqrt(np.linalg.eigvalsh(found.covariance)[1]))
        _warn(
            f"along {np.degrees(direction) % 180:.0f} degrees from east the place is known to "
            f"{worst:.1f} m only (one sigma): nothing changes along straight roads"
        )


def _warn(message: str) -> None:
    warnings.warn(message, GeoaimWarning, stacklevel=3)
