"""Place a map by imagery: windows of it that the imagery shows too become its control points."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt16
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.position import CLAIMS, read_position_covariance
from geoaim.aim.rectification import change_aim_world
from geoaim.base.errors import AlignmentError, warn
from geoaim.base.geometry import transform_points, translation
from geoaim.base.progress import Progress, notebook_progress
from geoaim.base.world import choose_world, world_from_lonlat
from geoaim.imagery.addresses import is_address
from geoaim.imagery.alignment.by_image import CORRELATED_WINDOWS, MatchedWindows, match_image
from geoaim.imagery.alignment.result import Prior
from geoaim.imagery.mosaic import read_imagery, read_lonlat
from geoaim.imagery.sources import Source, list_sources
from geoaim.imagery.tiles import Tiles
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.point_checks import warn_of_small_part
from geoaim.mapping.georeference.uncertainty import CORNERS
from geoaim.mapping.pipeline import remove_distortion
from geoaim.mapping.report import report_georeference, report_position

BY_TELEMETRY = Prior(35.0, float(np.radians(45.0)), 0.25)  # how far off telemetry may be
NEAR = Prior(35.0, float(np.pi), 0.25)  # and a position that is given by hand, in any direction
MAX_CORNER_PX = 2.0  # of the imagery; a corner that may be further off is warned of
# Standard deviations of a place, metres, of imagery that does not state its accuracy: an orthophoto
# within 6 m in 95 % of cases, as the USA's NAIP is by contract (Germany's and Switzerland's are
# better); web tiles within 10.2 m in 90 %, as scales of 1:12,000 ask and vendors of satellite
# mosaics state
UNSTATED_M, UNSTATED_TILES_M = 2.5, 4.8
# Pixels of the imagery, one sigma, by which all windows err together, by shadows and what leans.
# Validation places (seeds 11, 12; benchmarks.alignment.placing): without it 61 to 92 % of the
# ground inside the frame lies in its 95 % regions, with it 92 to 100 %
COMMON_ERROR_PX = 0.2
CELLS = 9  # of the longer side of the map; one window of each becomes a control point


def place_by_imagery(
    aim: AIM,
    imagery: AIM | Source | Sequence[Source],
    *,
    near: tuple[float, float] | None = None,
    accuracy: float | None = None,
    progress: Progress = notebook_progress,
) -> AIM:
    """Place a map by an orthophoto or tiles of the same ground, of any day, instead of points.

    Windows of the imagery are found in the map; those that agree become control points, one for
    each part of the map, and place it as points that are picked by hand do.

    Args:
        aim: the map, by telemetry; or of about the right scale in a local plane, with `near`.
        imagery: what `read_imagery` takes, or an AIM.
        near: latitude and longitude of about the map's middle, degrees, to within 35 m; the
            direction of north may then be any. None: where the map lies, or, if the
            imagery is an AIM in a local plane, about the middle of that AIM.
        accuracy: standard deviation of the imagery's own place, metres; with 0 it counts as right.
            None: as the report of an AIM states it, else 2.5 m, of web tiles 4.8 m.
        progress: called with the stage, how much is done and how much there is.

    Returns:
        The map in its place. Its report has the points under "georeference", and "position" says
        how well it is placed relative to the imagery and in the world.

    Raises:
        AlignmentError: the imagery does not show the map, or shows it in two places.
        GeoreferenceError: the windows do not fix a place.
        ImageryError: the imagery cannot be read.
        ValueError: a map in a local plane has no `near`.
    """
    rough, prior = _move_near(aim, near, imagery if isinstance(imagery, AIM) else None)
    margin = 1.5 * prior.max_shift
    region = np.stack([rough.corners.min(axis=0) - margin, rough.corners.max(axis=0) + margin])
    if isinstance(imagery, AIM):
        reference = change_aim_world(imagery, rough.world)
    else:
        reference = read_imagery(imagery, world=rough.world, corners=region)
    height, width = rough.coverage.shape
    windows = match_image(rough, reference, prior=prior, progress=progress)
    shared, supposed = _choose_covariance(reference, accuracy)
    points = _make_points(windows, rough, shared)
    points = replace(points, common_error=COMMON_ERROR_PX * reference.resolution)
    place = estimate_georeference(points, height=height, width=width, world=rough.world)
    warn_of_small_part(points, (height, width))
    stated = report_georeference(place, points)
    _warn_of_corners(stated["corner_uncertainty_m"], rough.coverage, reference.resolution)
    kept = {name: value for name, value in rough.report.items() if name not in (*CLAIMS, "place")}
    names = [Path(row["name"]).name for row in reference.report.get("imagery", [])]
    position = report_position(place, points) | supposed
    report = {
        **kept,
        "georeference": stated,
        "position": position | ({"reference": ", ".join(names)} if names else {}),
        "placed_by_imagery": {
            "source": ", ".join(names) or str(reference.report.get("source", "imagery")),
            "windows": len(windows.in_image),
            "control_points": len(points.names),
            "scatter_m": points.accuracy,
            "imagery_accuracy_m": float(np.sqrt(np.trace(shared) / 2)),
        },
    }
    straight = remove_distortion(rough, place.radial)
    return replace(straight, world_from_image=place.world_from_image, report=report)


def parse_near(text: str) -> tuple[float, float]:
    """Parse latitude and longitude, degrees, with a comma or a space between them.

    >>> parse_near("49.99,36.23")
    (49.99, 36.23)
    """
    try:
        latitude, longitude = map(float, text.replace(",", " ").split())
    except ValueError:
        raise ValueError(
            f"near {text!r} is not latitude,longitude in degrees, such as 49.99,36.23"
        ) from None
    if not (abs(latitude) <= 90 and abs(longitude) <= 180):
        raise ValueError(f"near {text!r}: a latitude is at most 90, a longitude at most 180")
    return latitude, longitude


def check_near(imagery: Source | Sequence[Source], near: tuple[float, float]) -> None:
    """Check before any work that imagery shows a place; that of a tile service is not known.

    Args:
        imagery: as in `place_by_imagery`.
        near: latitude and longitude, degrees.

    Raises:
        AlignmentError: it does not.
        ImageryError: the imagery cannot be read.
    """
    sources = list_sources(imagery)
    if any(isinstance(one, Tiles) or is_address(str(one)) for one in sources):
        return
    lonlat = read_lonlat(sources, None)
    low, high = lonlat.min(axis=0), lonlat.max(axis=0)
    place = np.array(near[::-1])
    if ((low <= place) & (place <= high)).all():
        return
    swapped = ((low <= place[::-1]) & (place[::-1] <= high)).all()
    advice = "give the latitude first" if swapped else "is it of another place?"
    raise AlignmentError(
        f"latitude {near[0]:g}, longitude {near[1]:g} lies outside of the imagery, which has "
        f"longitude {low[0]:.6f} to {high[0]:.6f}, latitude {low[1]:.6f} to {high[1]:.6f}: {advice}"
    )


def _move_near(
    aim: AIM, near: tuple[float, float] | None, reference: AIM | None
) -> tuple[AIM, Prior]:
    """Move the middle of a map to where it is said to be; with how far off it may be then."""
    if near is not None:
        lonlat = np.array([[near[1], near[0]]])
        world = choose_world(lonlat)
        there = world_from_lonlat(world, lonlat)[0]
    elif reference is not None and reference.world.crs is None:  # their middles lie close then
        world, there = reference.world, reference.corners.mean(axis=0)
    elif aim.world.crs is not None:
        return aim, BY_TELEMETRY
    else:
        raise ValueError(
            "the map has no place in the world; give near=(latitude, longitude) (--near)"
        )
    height, width = aim.coverage.shape
    middle = transform_points(aim.world_from_image, np.array([[width / 2, height / 2]]))[0]
    report = {name: value for name, value in aim.report.items() if name not in (*CLAIMS, "place")}
    matrix = translation(*(there - middle)) @ aim.world_from_image
    return replace(aim, world=world, world_from_image=matrix, report=report), NEAR


def _warn_of_corners(
    bounds: Float[Array, "4"], coverage: UInt16[Array, "H W"], resolution: float
) -> None:
    """Name the corners of a map that show ground and may be further off than `MAX_CORNER_PX`."""
    shown = coverage[[0, 0, -1, -1], [0, -1, -1, 0]] > 0
    far = np.flatnonzero(shown & (bounds > MAX_CORNER_PX * resolution))
    if len(far):
        listed = ", ".join(f"{CORNERS[corner]} {bounds[corner]:.1f} m" for corner in far)
        warn(
            f"corners of the map may be off (95 %): {listed}; too few windows of the imagery lie"
            " near them"
        )


def _choose_covariance(
    reference: AIM, accuracy: float | None
) -> tuple[Float[Array, "2 2"], dict[str, Any]]:
    """Choose the covariance of the imagery's place; with what the position says was supposed."""
    if accuracy is not None:
        return accuracy**2 * np.eye(2), {} if accuracy else {"assumes": ["imagery"]}
    own = read_position_covariance(reference.report)
    if own is not None:
        return own, {}
    rows = reference.report.get("imagery", [])
    tiled = any(row["zoom"] is not None or row["name"].endswith(".mbtiles") for row in rows)
    sigma = UNSTATED_TILES_M if tiled else UNSTATED_M
    return sigma**2 * np.eye(2), {"supposed_accuracy_m": sigma}


def _make_points(windows: MatchedWindows, rough: AIM, shared: Float[Array, "2 2"]) -> ControlPoints:
    """Make control points of windows that agree, one for each cell of the map."""
    height, width = rough.coverage.shape
    pixels = transform_points(np.linalg.inv(rough.world_from_image), windows.in_image)
    inside = ((pixels > 0) & (pixels < [width, height])).all(axis=1)
    if not inside.any():
        raise AlignmentError("no window of the imagery lies on the map; is it the same place?")
    pixels, places = pixels[inside], windows.in_reference[inside]
    information = windows.information[inside]
    chosen = _select_sharpest(pixels, information, max(height, width) / CELLS)
    return ControlPoints(
        pixels=pixels[chosen],
        coordinates=places[chosen] + np.array(rough.world.origin),
        crs=rough.world.crs,
        names=tuple(f"window {number}" for number in chosen.tolist()),
        frames=(None,) * len(chosen),
        accuracy=float(np.sqrt(np.mean(windows.residuals**2))),
        shared_covariance=shared,
        information=information[chosen],
        redundancy=CORRELATED_WINDOWS,
    )


def _select_sharpest(
    pixels: Float[Array, "m 2"], information: Float[Array, "m 2 2"], cell: float
) -> Int[Array, " n"]:
    """Select the point of each square cell that is known best in its worst direction."""
    number = np.floor(pixels / cell)
    order = np.argsort(-np.linalg.eigvalsh(information)[:, 0])
    _, first = np.unique(number[order], axis=0, return_index=True)
    return np.sort(order[first])
