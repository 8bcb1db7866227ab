"""Plane curves as polylines: arcs, smooth connections, equal spacing, offset curves."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

Polyline = Float[Array, "_ 2"]
POINT_SPACING_M = 0.5  # distance between the points of a lane or path
QUINTIC_POINTS = 200


def make_unit_vector(angle: float) -> Float[Array, "2"]:
    """Make the vector of length 1 at an angle (radians, counter-clockwise from +x)."""
    return np.array([np.cos(angle), np.sin(angle)])


def rotate_90(vectors: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
    """Rotate vectors by 90 degrees counter-clockwise."""
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)


def compute_headings(line: Polyline) -> Float[Array, "L"]:
    """Compute the direction at each point, in radians without jumps, so that it may exceed pi."""
    tangent = np.gradient(line, axis=0, edge_order=2 if len(line) > 2 else 1)
    return np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))


def compute_arc_lengths(line: Polyline) -> Float[Array, "L"]:
    """Compute the length of a polyline up to each of its points, metres; 0 at the first."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])


def compute_curvature(line: Polyline) -> Float[Array, "L"]:
    """Compute the curvature (1/m, positive to the left) at each of equally spaced points."""
    spacing = compute_arc_lengths(line)[-1] / max(len(line) - 1, 1)
    return np.gradient(compute_headings(line)) / spacing


def resample_polyline(line: Polyline, spacing: float = POINT_SPACING_M) -> Polyline:
    """Resample a polyline at equal distances of about `spacing` metres; both ends stay."""
    s = compute_arc_lengths(line)
    samples = np.linspace(0, s[-1], max(2, round(s[-1] / spacing) + 1))
    return np.stack([np.interp(samples, s, line[:, k]) for k in (0, 1)], axis=1)


def offset_polyline(line: Polyline, left: Float[Array, "L"] | float) -> Polyline:
    """Make the parallel curve `left` metres (one number, or one at each point) to the left."""
    angle = compute_headings(line)
    normal = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    return line + np.reshape(left, (-1, 1)) * normal


def sample_arc(radius: float, angles: tuple[float, float]) -> Polyline:
    """Sample an arc about the origin from one angle to another (radians), every 0.5 m or so."""
    start, end = angles
    angle = np.linspace(start, end, max(2, round(abs(end - start) * radius / POINT_SPACING_M) + 1))
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def connect_poses(
    start: Float[Array, "2"],
    start_heading: float,
    end: Float[Array, "2"],
    end_heading: float,
    *,
    start_curvature: float = 0.0,
    end_curvature: float = 0.0,
) -> Polyline:
    """Connect two poses by a quintic Hermite curve, so that the steering angle is continuous.

    Of several speeds along the parameter, the one with the least maximum curvature is chosen.

    Args:
        start: first point, metres.
        start_heading: radians.
        end: last point.
        end_heading: radians.
        start_curvature: 1/m, positive to the left.
        end_curvature: 1/m.

    Returns:
        Points about `POINT_SPACING_M` apart, from `start` to `end`.
    """
    chord = float(np.hypot(*(end - start)))
    ahead = make_unit_vector(start_heading), make_unit_vector(end_heading)
    lines = []
    for stretch in np.arange(0.7, 1.75, 0.05):
        speed = stretch * chord
        velocities = speed * ahead[0], speed * ahead[1]
        bends = speed**2 * start_curvature, speed**2 * end_curvature
        accelerations = bends[0] * rotate_90(ahead[0]), bends[1] * rotate_90(ahead[1])
        lines.append(resample_polyline(_sample_quintic((start, end), velocities, accelerations)))
    return min(lines, key=lambda line: float(np.abs(compute_curvature(line)).max()))


def _sample_quintic(
    points: tuple[Array, Array], velocities: tuple[Array, Array], accelerations: tuple[Array, Array]
) -> Polyline:
    """The quintic polynomial with these values and derivatives at 0 and 1."""
    t = np.linspace(0, 1, QUINTIC_POINTS)[:, None]
    (start, end), (start_v, end_v), (start_a, end_a) = points, velocities, accelerations
    x = end - start - start_v - start_a / 2
    v = end_v - start_v - start_a
    a = end_a - start_a
    cubic = 10 * x - 4 * v + a / 2
    quartic = -15 * x + 7 * v - a
    quintic = 6 * x - 3 * v + a / 2
    return start + t * (start_v + t * (start_a / 2 + t * (cubic + t * (quartic + t * quintic))))
