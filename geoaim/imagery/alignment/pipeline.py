"""The stages in order for imagery of others: reading -> evidence of its place -> AIM."""

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.errors import AlignmentError, GeoaimWarning, ImageryError, TracksError
from geoaim.geometry import transform_points, translation
from geoaim.imagery.alignment.by_image import align_image
from geoaim.imagery.alignment.by_tracks import align_tracks
from geoaim.imagery.alignment.result import CHI2, PRIOR, Alignment, Prior, moved, report_alignment
from geoaim.imagery.mosaic import read_imagery
from geoaim.imagery.rasters import describe_raster
from geoaim.imagery.resampling import (
    MIN_ALPHA,
    estimate_stretch,
    resample_raster,
    unpremultiply,
)
from geoaim.imagery.sources import Source
from geoaim.mapping.georeference.control_points import read_control_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.report import report_georeference
from geoaim.mapping.video.video import open_video
from geoaim.rectify import rectify
from geoaim.track_changes import to_world
from geoaim.tracks import Tracks
from geoaim.world import World

MARGIN = 20.0  # m around tracks that the map shows
STRIP = 2048  # rows of a picture that are read at a time
MASKED = {".png", ".tif", ".tiff"}  # pictures that may hide a part; others are set upright
Align = Callable[[AIM], Alignment]


def align_tiles(
    tiles: Source | Sequence[Source],
    *,
    tracks: Tracks | None = None,
    aim: AIM | None = None,
    gcps: Any = None,
    prior: Prior = PRIOR,
    **options: Any,
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
        prior: how far off the imagery may be.
        options: of `read_imagery`: resolution, crs, bands. With control points resolution, which
            lays the picture north up, and crs, of points that name none.

    Returns:
        The map, in the world of the AIM or else of the tracks; its report says how well its
        place is known, and in which direction it is not.

    Raises:
        ImageryError: the imagery cannot be read, or is elsewhere.
        TracksError: the tracks that shall place it hold nobody.
        AlignmentError: the evidence does not tell where it lies, or fits in two ways.
        GeoreferenceError: the control points do not fix a place.
        ValueError: a call that cannot be.

    >>> align_tiles([])
    Traceback (most recent call last):
        ...
    ValueError: no source of imagery was given: name at least one
    """
    if aim is not None and tracks is not None:
        tracks = to_world(tracks, aim.world)
    if gcps is not None:
        world = next((given.world for given in (aim, tracks) if given is not None), None)
        imagery, placed = _by_control_points(tiles, gcps, world, **options), True
    else:
        world, corners = _wanted(aim, tracks, prior)
        imagery = read_imagery(tiles, world=world, corners=corners, **options)
        placed = False
    for name, given, align in _evidence(aim, tracks, prior):
        if placed:
            imagery = _checked(imagery, name, given, align)
        else:
            found = align(imagery)
            imagery = _with_report(moved(imagery, found), name, report_alignment(found))
            _warn_of_direction(found)
            placed = True
    return imagery


def _evidence(
    aim: AIM | None, tracks: Tracks | None, prior: Prior
) -> list[tuple[str, AIM | Tracks, Align]]:
    """What is given, from the strongest on."""
    found: list[tuple[str, AIM | Tracks, Align]] = []
    if aim is not None:
        found.append(("aim", aim, lambda imagery: align_image(imagery, aim, prior=prior)))
    if tracks is not None:
        found.append(("tracks", tracks, lambda imagery: align_tracks(imagery, tracks, prior=prior)))
    return found


def _ground(given: AIM | Tracks) -> Float[Array, "2 2"]:
    """The least and most x and y of what evidence shows."""
    places = given.corners if isinstance(given, AIM) else given.states[given.present][:, :2]
    if not len(places):
        raise TracksError("nobody is present in the tracks at any time; give others, or none")
    return np.stack([places.min(axis=0), places.max(axis=0)])


def _wanted(
    aim: AIM | None, tracks: Tracks | None, prior: Prior
) -> tuple[World | None, Float[Array, "n 2"] | None]:
    """The world and ground to read, with what may be moved into it."""
    reach = np.array([[-prior.reach], [prior.reach]])
    if aim is not None:
        return aim.world, _ground(aim) + reach
    if tracks is not None:
        return tracks.world, _ground(tracks) + reach + np.array([[-MARGIN], [MARGIN]])
    return None, None


def _by_control_points(
    tiles: Source | Sequence[Source],
    gcps: Any,
    world: World | None,
    *,
    crs: str | None = None,
    resolution: float | None = None,
) -> AIM:
    """One picture where control points lay it."""
    if not isinstance(tiles, str | os.PathLike):
        raise ValueError("control points are pixels of one picture; give one file")
    points = read_control_points(gcps, crs=crs)
    image, seen = _picture(Path(tiles))
    height, width = seen.shape
    place = estimate_georeference(points, height=height, width=width, world=world)
    placed = AIM(
        image=image,
        world_from_image=place.world_from_image,
        world=place.world,
        coverage=seen.astype(np.uint16),
        contested=np.zeros((height, width), bool),
        report={"source": str(tiles), "georeference": report_georeference(place, points)},
    )
    return placed if resolution is None else rectify(placed, resolution)


def _picture(path: Path) -> tuple[UInt8[Array, "H W 3"], Bool[Array, "H W"]]:
    """One picture, and where it shows something."""
    if path.is_file() and path.suffix.lower() in MASKED:
        return _masked_picture(path)
    image, *others = [frame.image for frame in islice(open_video(str(path)), 2)]
    if others:
        raise ValueError(f"{path} holds several pictures; control points are of one")
    return image, np.ones(image.shape[:2], bool)


def _masked_picture(path: Path) -> tuple[UInt8[Array, "H W 3"], Bool[Array, "H W"]]:
    """Without what nodata, masks and alpha hide; more than 8 bits are stretched."""
    raster = describe_raster(str(path), georeference=("pixels", np.eye(3)))
    stretch = estimate_stretch([raster], {"pixels": np.array([[0.0, 0.0], [1.0, 1.0]])})
    image = np.zeros((*raster.grid.shape, 3), np.uint8)
    seen = np.zeros(image.shape[:2], bool)
    for top in range(0, raster.grid.height, STRIP):
        strip = image[top : top + STRIP]
        raster_from_strip = translation(0, top)
        placed = resample_raster(raster, raster_from_strip, strip.shape[:2], stretch)
        if placed is not None:
            strip[:] = unpremultiply(placed[2])
            seen[top : top + STRIP] = placed[2][3] >= MIN_ALPHA
    if not seen.any():
        raise ImageryError(f"{path} shows nothing but nodata or transparency; give another picture")
    return image, seen


def _checked(imagery: AIM, name: str, given: AIM | Tracks, align: Align) -> AIM:
    """The imagery as it is placed, with what other evidence says of it."""
    try:
        found = align(imagery)
    except AlignmentError as error:
        _warn(f"the {name} could not check the place: {error}")
        return _with_report(imagery, name, {"checked": False, "why": str(error)})
    corners = np.clip(imagery.corners, *_ground(given))  # beyond, the evidence knows nothing
    apart = transform_points(found.true_from_stated, corners) - corners
    covariance = _uncertainty(found, corners) + _placing(imagery)
    squares = np.einsum("mi,mij,mj->m", apart, np.linalg.inv(covariance), apart)
    agrees = bool(squares.mean() < 2 * CHI2)
    off = float(np.linalg.norm(apart, axis=1).max())
    known = float(np.sqrt(CHI2 * np.trace(covariance, axis1=1, axis2=2).max() / 2))
    said = {"checked": True, "agrees": agrees, "corners_off_m": off, "corners_known_to_m": known}
    if not agrees:
        east, north = found.shift
        _warn(
            f"by the {name} the imagery's corners would lie up to {off:.2f} m from where they are "
            f"placed, and its middle {east:.2f} m east and {north:.2f} m north, more than the "
            f"uncertainty of both, {known:.2f} m (95 %): is the {name} or what placed it wrong?"
        )
    return _with_report(imagery, name, report_alignment(found) | said)


def _uncertainty(found: Alignment, places: Float[Array, "m 2"]) -> Float[Array, "m 2 2"]:
    """Covariance of places by what was found, with that of its turn where it is stated."""
    sigma = np.radians(found.evidence.get("turn_sigma_degrees", 0.0))
    across = sigma * (places - found.middle)[:, ::-1] * [-1.0, 1.0]
    return found.covariance + across[:, :, None] * across[:, None]


def _placing(imagery: AIM) -> Float[Array, "2 2"]:
    """Covariance of a place by what has placed the imagery."""
    report: Any = imagery.report
    if "georeference" in report:
        bounds = np.array(report["georeference"]["corner_uncertainty_m"])
        return np.eye(2) * np.mean(bounds**2) / CHI2
    [placed] = [said for said in report["alignment"].values() if "checked" not in said]
    return np.array(placed["covariance_m2"])


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
