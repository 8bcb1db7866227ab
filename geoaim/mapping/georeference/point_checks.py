"""Checks of control points before any fit; `estimate.py` refuses points that disagree with it.

Errors name the points and the remedy.
"""

from collections.abc import Sequence

import numpy as np

from geoaim.base.errors import GeoreferenceError, warn
from geoaim.base.geometry import image_corners
from geoaim.base.world import (
    LONLAT,
    METRES_PER_DEGREE,
    describe_misplacement,
    parse_crs,
    transform_crs,
)
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.transform_models import (
    Points,
    fit_similarity,
    half_diagonal,
    normalise_pixels,
)

MIN_POINTS = 4
PICKING_SIGMA_PX = 2.0  # assumed of a picked point's coordinates
MIN_PIXEL_DISTANCE = 0.5  # px between two points
MIN_GROUND_DISTANCE = 1e-3  # m between two points
MIN_EXTENT = 0.1  # m; degrees that are taken for metres have less
# share of the image's sides; if no point lies beyond it, the points may be of a smaller picture
MAX_SMALLER = 2 / 3
# share of half the diagonal: 95 % region of an affine fit in the worst corner
MAX_CORNER_ERROR = 0.15
GAUSSIAN_ELLIPSE = 2.45  # standard deviations to the ellipse that holds 95 % in the plane
RESOLUTION_RANGE = (1e-4, 100.0)  # metres per pixel of any picture of the ground


def check_coordinates(points: ControlPoints) -> None:
    """Check that the coordinates lie in their CRS's area of use.

    Raises:
        GeoreferenceError: they do not; the message says if x and y seem to be swapped.
    """
    if points.crs is not None and (
        problem := describe_misplacement(points.crs, points.coordinates)
    ):
        raise GeoreferenceError(f"{_list_names(points.names)}: {problem}")


def check_layout(
    points: ControlPoints, targets: Points, size: tuple[int, int], *, outside: bool = False
) -> None:
    """Check that control points on one image of (height, width) can fix a transform."""
    _check_count(points)
    check_distinctness(points, targets)
    _check_spread(points, size)
    _check_mirroring(points, targets, size)
    if not outside:
        check_inside(points, size)
    scale = fit_similarity(normalise_pixels(points.pixels, size), targets)[0][:2, 0]
    resolution = float(np.hypot(*scale)) / half_diagonal(*size)
    low, high = RESOLUTION_RANGE
    if not low <= resolution <= high:
        raise GeoreferenceError(
            f"The control points give {resolution:.3g} metres per pixel; {low:g} to {high:g} is"
            " possible. Are the coordinates in the CRS and the units that they state?"
        )


def check_distinctness(points: ControlPoints, targets: Points) -> None:
    """Check that no two control points have the same pixel or place; targets are in metres."""
    _check_distances(points.names, points.pixels, MIN_PIXEL_DISTANCE, "pixel")
    _check_extent(points, targets)
    _check_distances(points.names, targets, MIN_GROUND_DISTANCE, "place")


def _check_count(points: ControlPoints) -> None:
    if len(points.names) < MIN_POINTS:
        raise GeoreferenceError(
            f"{len(points.names)} control points ({_list_names(points.names)}) were given; at least"
            f" {MIN_POINTS} are needed, better six or more, spread over the image."
        )
    frames = sorted({str(frame) for frame in points.frames})
    if len(frames) > 1:
        raise GeoreferenceError(
            f"The control points were picked on {len(frames)} frames ({', '.join(frames[:6])}):"
            " transform their pixels to one image first."
        )


def _check_extent(points: ControlPoints, targets: Points) -> None:
    extent = float(np.ptp(targets, axis=0).max())
    if extent < MIN_EXTENT:
        crs = points.crs or "a local plane"
        raise GeoreferenceError(
            f"{_list_names(points.names)} lie within {extent:.2g} m in {crs}, such as at"
            f" {tuple(points.coordinates[0].tolist())}. If these are degrees of longitude and"
            " latitude, write '# crs: EPSG:4326' into their file."
        )


def _check_distances(names: tuple[str, ...], values: Points, limit: float, quantity: str) -> None:
    from scipy.spatial import cKDTree  # a build without points needs none

    # of each point the two nearest, of which one may be itself
    _, nearest = cKDTree(values).query(values, k=2, distance_upper_bound=limit)
    own = np.arange(len(values))[:, None]
    close = (nearest != own) & (nearest < len(values))
    if close.any():
        first = int(close.any(axis=1).argmax())
        pair = [first, int(nearest[first][close[first]].min())]
        raise GeoreferenceError(
            f"{_list_names([names[i] for i in pair])} have the same {quantity}. Remove one of"
            " them, or correct it if it was copied by mistake."
        )


def _check_spread(points: ControlPoints, size: tuple[int, int]) -> None:
    """Check the error at the image's corners by an affine fit without any prior."""
    plane = normalise_pixels(points.pixels, size)
    middle = plane.mean(axis=0)
    _, spread, axes = np.linalg.svd(plane - middle, full_matrices=False)
    corners = (normalise_pixels(image_corners(*size), size) - middle) @ axes.T
    leverage = 1.0 / len(plane) + np.sum((corners / np.maximum(spread, 1e-12)) ** 2, axis=1)
    error = GAUSSIAN_ELLIPSE * PICKING_SIGMA_PX * np.sqrt(leverage).max()
    if error <= MAX_CORNER_ERROR * half_diagonal(*size):
        return
    layout, remedy = "close together", "far away"
    if spread[1] < 0.2 * spread[0]:
        layout, remedy = "nearly on a line", "off that line"
    raise GeoreferenceError(
        f"{_list_names(points.names)} lie {layout}: with {PICKING_SIGMA_PX:g} px of picking error"
        f" the image's corners would be off by {min(error, 1e6):.0f} px. Add a point {remedy}."
    )


def _check_mirroring(points: ControlPoints, targets: Points, size: tuple[int, int]) -> None:
    plane = normalise_pixels(points.pixels, size)
    plain, mirrored = (fit_similarity(plane, targets, mirrored=m)[1] for m in (False, True))
    if plain <= mirrored:
        return
    errors = {"v counts upwards (it must count down from the top)": mirrored}
    if (points.pixels[:, ::-1] <= (size[1], size[0])).all():
        errors["u and v are swapped"] = mirrored
    if points.crs is None:
        errors["x and y are swapped"] = mirrored
    elif not describe_misplacement(points.crs, points.coordinates[:, ::-1]):
        swapped = "longitude and latitude" if parse_crs(points.crs).is_geographic else "x and y"
        errors[f"{swapped} are swapped"] = _measure_swapped_error(
            points.crs, points, plane, targets
        )
    likely = [cause for cause, error in errors.items() if error <= 4.0 * min(errors.values())]
    causes = f"Either {', or '.join(likely)}: correct it" if len(likely) > 1 else likely[0]
    separator = "." if len(likely) > 1 else ":"
    raise GeoreferenceError(
        f"{_list_names(points.names)} show the ground mirrored{separator} {causes}."
    )


def _measure_swapped_error(
    crs: str, points: ControlPoints, plane: Points, targets: Points
) -> float:
    """Squared error of a fit with swapped coordinates, at the given targets' scale."""
    lonlat = transform_crs(crs, LONLAT, points.coordinates[:, ::-1])
    metres = METRES_PER_DEGREE * np.array([np.cos(np.radians(lonlat[:, 1].mean())), 1.0])
    matrix, error = fit_similarity(plane, (lonlat - lonlat.mean(axis=0)) * metres)
    given = fit_similarity(plane, targets, mirrored=True)[0]
    return error * float(np.linalg.det(given[:2, :2]) / np.linalg.det(matrix[:2, :2]))


def check_inside(points: ControlPoints, size: tuple[int, int]) -> None:
    """Check that points lie on the images of (height, width) that they were picked on."""
    height, width = size
    outside = ((points.pixels < -0.5) | (points.pixels > (width + 0.5, height + 0.5))).any(axis=1)
    if outside.any():
        names = [points.names[i] for i in np.flatnonzero(outside)]
        raise GeoreferenceError(
            f"{_list_names(names)} lie outside the image of {width} x {height} pixels. Were they"
            " picked at another resolution, or are u and v swapped?"
        )


def warn_of_small_part(points: ControlPoints, size: tuple[int, int]) -> None:
    """Warn where all points may have been picked on a smaller picture than (height, width)."""
    height, width = size
    reached = points.pixels.max(axis=0)
    if (reached <= MAX_SMALLER * np.array([width, height])).all():
        warn(
            f"all control points lie in the upper left {reached[0]:.0f} x {reached[1]:.0f} of"
            f" {width} x {height} pixels. If they were picked on a smaller picture, pick them on"
            " one of this size (`geoaim frame`); otherwise add a point at the lower right"
        )


def _list_names(names: Sequence[str]) -> str:
    """List up to 8 names, more by their number."""
    if len(names) > 8:
        names = [*names[:7], f"{len(names) - 7} more"]
    return ", ".join(names)
