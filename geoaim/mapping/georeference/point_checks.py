"""Refuse control points that cannot fix a place, by name and with what to do."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import GeoreferenceError
from geoaim.geometry import image_corners
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.world import LONLAT, parse_crs, transform_crs

FEWEST = 4
SAME_PIXEL = 0.5  # px
SAME_PLACE = 1e-3  # m
SPREAD = 0.05  # an affine fit's 95 % region at the worst corner, as a share of half the diagonal
SCALES = (1e-4, 100.0)  # metres per pixel that a picture of the ground may have


def half_diagonal(height: float, width: float) -> float:
    """Half the image's diagonal in pixels."""
    return float(np.hypot(height, width) / 2.0)


def plane_from_image(height: float, width: float) -> Float[Array, "3 3"]:
    """Pixels to the normalised plane: origin at the centre, x right, y up, unit half diagonal."""
    unit = half_diagonal(height, width)
    return np.array(
        [[1.0, 0.0, -width / 2.0], [0.0, -1.0, height / 2.0], [0.0, 0.0, unit]]
    ) / unit  # fmt: skip


def fit_similarity(
    points: Float[Array, "m 2"], targets: Float[Array, "m 2"], *, mirrored: bool = False
) -> tuple[Float[Array, "3 3"], float]:
    """The similarity that fits best without its worst point, and its squared error.

    Without it, because one point that is kilometres off would spoil the scale that everything
    later is measured by.
    """
    z = points[:, 0] + 1j * points[:, 1]
    z = z.conj() if mirrored else z
    q = targets[:, 0] + 1j * targets[:, 1]
    fits = [_complex_fit(z, q, keep) for keep in ~np.eye(len(z), dtype=bool)]
    error, a, b = min(fits, key=lambda fit: fit[0]) if len(z) > 3 else _complex_fit(z, q)
    matrix = [[a.real, -a.imag, b.real], [a.imag, a.real, b.imag], [0.0, 0.0, 1.0]]
    return np.array(matrix), error


def _complex_fit(
    z: Array, q: Array, keep: Array | slice = slice(None)
) -> tuple[float, complex, complex]:
    centre, middle = z[keep].mean(), q[keep].mean()
    a = np.vdot(z[keep] - centre, q[keep] - middle) / np.vdot(z[keep] - centre, z[keep] - centre)
    error = np.sum(np.abs(q[keep] - middle - a * (z[keep] - centre)) ** 2)
    return float(error), complex(a), complex(middle - a * centre)


def refuse_coordinates(points: ControlPoints) -> None:
    """Refuse coordinates that lie outside their CRS's area, and say when a swap would mend it.

    Raises:
        GeoreferenceError: they do.
    """
    if points.crs is None or _inside(points.crs, points.coordinates):
        return
    swapped = _inside(points.crs, points.coordinates[:, ::-1])
    order = "longitude, latitude" if parse_crs(points.crs).is_geographic else "easting, northing"
    first = tuple(points.coordinates[0].tolist())
    advice = (
        f"x and y are swapped: give {order}."
        if swapped
        else "Is the CRS the right one, and are the coordinates in its units?"
    )
    raise GeoreferenceError(
        f"{_all(points)}: the coordinates, such as {first}, lie outside"
        f" the area of {points.crs}. {advice}"
    )


def _inside(crs: str, coordinates: Float[Array, "m 2"], margin: float = 5.0) -> bool:
    try:
        lonlat = transform_crs(crs, LONLAT, coordinates)
    except GeoreferenceError:
        return False
    area = parse_crs(crs).area_of_use
    if np.abs(lonlat[:, 1]).max() > 90.0:
        return False
    if area is None or area.east < area.west:
        return True
    low, high = (area.west - margin, area.south - margin), (area.east + margin, area.north + margin)
    return bool(((lonlat >= low) & (lonlat <= high)).all())


def refuse_layout(
    points: ControlPoints,
    targets: Float[Array, "m 2"],
    size: tuple[int, int],
    accuracy: float,
) -> None:
    """Refuse points that are too few, from several frames, repeated, on a line, mirrored, outside.

    Args:
        points: control points, all on one image.
        targets: (M, 2) where they lie, metres.
        size: height and width of the image.
        accuracy: one sigma of a picked point, pixels.

    Raises:
        GeoreferenceError: one of these, with the points' names.
    """
    if len(points.names) < FEWEST:
        raise GeoreferenceError(
            f"{len(points.names)} control points ({_all(points)}); at"
            f" least {FEWEST} are needed, six or more spread over the image are good."
        )
    frames = sorted({str(frame) for frame in points.frames})
    if len(frames) > 1:
        raise GeoreferenceError(
            f"The control points were picked on {len(frames)} frames ({', '.join(frames[:6])}):"
            " bring their pixels into one image first."
        )
    _refuse_repeats(points, targets)
    plane = plane_points(points.pixels, *size)
    _refuse_narrow(points, plane, size, accuracy)
    _refuse_mirrored(points, plane, targets, size)
    _refuse_outside(points, size)
    scale = float(np.hypot(*fit_similarity(plane, targets)[0][:2, 0])) / half_diagonal(*size)
    if not SCALES[0] <= scale <= SCALES[1]:
        raise GeoreferenceError(
            f"The control points give {scale:.3g} metres per pixel; {SCALES[0]:g} to {SCALES[1]:g}"
            " is possible. Are the coordinates in the CRS and the units that they claim?"
        )


def plane_points(pixels: Float[Array, "m 2"], height: int, width: int) -> Float[Array, "m 2"]:
    """Pixels in the normalised plane."""
    matrix = plane_from_image(height, width)
    return np.asarray(pixels, np.float64) @ matrix[:2, :2].T + matrix[:2, 2]


def _refuse_repeats(points: ControlPoints, targets: Float[Array, "m 2"]) -> None:
    for values, limit, what in (
        (points.pixels, SAME_PIXEL, "pixel"),
        (targets, SAME_PLACE, "place"),
    ):
        gap = np.linalg.norm(values[:, None] - values[None], axis=2)
        pairs = np.argwhere(np.triu(gap < limit, 1))
        if len(pairs):
            raise GeoreferenceError(
                f"{_listed(points, pairs[0].tolist())} have the same {what}. Remove one of them, or"
                " correct it if it was copied by mistake."
            )


def _refuse_narrow(
    points: ControlPoints, plane: Float[Array, "m 2"], size: tuple[int, int], accuracy: float
) -> None:
    """Without any prior, how well do the points fix the corners by an affine fit?"""
    centred = plane - plane.mean(axis=0)
    _, spread, axes = np.linalg.svd(centred, full_matrices=False)
    corners = (plane_points(image_corners(*size), *size) - plane.mean(axis=0)) @ axes.T
    reach = np.sqrt(1.0 / len(plane) + np.sum((corners / np.maximum(spread, 1e-12)) ** 2, axis=1))
    error = 2.45 * accuracy * reach.max()
    if error <= SPREAD * half_diagonal(*size):
        return
    line = spread[1] < 0.2 * spread[0]
    how, where = ("nearly on a line", "off that line") if line else ("close together", "far away")
    raise GeoreferenceError(
        f"{_all(points)} lie {how}: with {accuracy:g} px of picking error the image's corners would"
        f" be off by {min(error, 1e6):.0f} px. Add a point {where}."
    )


def _refuse_mirrored(
    points: ControlPoints,
    plane: Float[Array, "m 2"],
    targets: Float[Array, "m 2"],
    size: tuple[int, int],
) -> None:
    straight, turned = (fit_similarity(plane, targets, mirrored=m)[1] for m in (False, True))
    if straight <= turned:
        return
    fixes = {"v counts upwards (it must count down from the top)": turned}
    if (points.pixels[:, ::-1] <= (size[1], size[0])).all():
        fixes["u and v are swapped"] = turned
    if points.crs is None:
        fixes["x and y are swapped"] = turned
    elif _inside(points.crs, points.coordinates[:, ::-1]):
        swapped = "longitude and latitude" if parse_crs(points.crs).is_geographic else "x and y"
        fixes[f"{swapped} are swapped"] = _swapped_error(points, plane, targets)
    best = min(fixes.values())
    likely = [fix for fix, error in fixes.items() if error <= 4.0 * best]
    raise GeoreferenceError(
        f"{_all(points)} show the ground mirrored. Either {', or '.join(likely)}: correct it."
        if len(likely) > 1
        else f"{_all(points)} show the ground mirrored: {likely[0]}."
    )


def _swapped_error(
    points: ControlPoints, plane: Float[Array, "m 2"], targets: Float[Array, "m 2"]
) -> float:
    """Squared error after swapping the coordinates' columns, at the given targets' scale."""
    crs = str(points.crs)
    lonlat = transform_crs(crs, LONLAT, points.coordinates[:, ::-1])
    metres = 111_320.0 * np.array([np.cos(np.radians(lonlat[:, 1].mean())), 1.0])
    matrix, error = fit_similarity(plane, (lonlat - lonlat.mean(axis=0)) * metres)
    given = fit_similarity(plane, targets, mirrored=True)[0]
    return error * float(np.linalg.det(given[:2, :2]) / np.linalg.det(matrix[:2, :2]))


def _refuse_outside(points: ControlPoints, size: tuple[int, int]) -> None:
    height, width = size
    outside = ((points.pixels < -0.5) | (points.pixels > (width + 0.5, height + 0.5))).any(axis=1)
    if outside.any():
        raise GeoreferenceError(
            f"{_listed(points, np.flatnonzero(outside).tolist())} lie outside the image of {width}"
            f" x {height} pixels. Were they picked at another resolution, or are u and v swapped?"
        )


def _all(points: ControlPoints) -> str:
    return _listed(points, range(len(points.names)))


def _listed(points: ControlPoints, indices: Iterable[int]) -> str:
    names = [points.names[i] for i in indices]
    if len(names) > 8:
        names = [*names[:7], f"{len(names) - 7} more"]
    return ", ".join(names)
