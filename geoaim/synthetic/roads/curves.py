"""Plane curves as points: arcs, smooth joints, equal steps, parallels."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

Line = Float[Array, "_ 2"]
STEP = 0.5  # m between the points of a lane or a way


def unit(angle: float) -> Float[Array, "2"]:
    """The direction of an angle (radians, counter-clockwise from +x)."""
    return np.array([np.cos(angle), np.sin(angle)])


def left_of(vectors: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
    """Vectors turned by a quarter to the left."""
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)


def headings(line: Line) -> Float[Array, "L"]:
    """Direction at each point, radians, without jumps of a full turn."""
    ahead = np.gradient(line, axis=0, edge_order=2 if len(line) > 2 else 1)
    return np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))


def run(line: Line) -> Float[Array, "L"]:
    """Metres along the line at each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])


def even(line: Line, step: float = STEP) -> Line:
    """The line with points at equal distances of about a step; both ends stay."""
    along = run(line)
    at = np.linspace(0, along[-1], max(2, round(along[-1] / step) + 1))
    return np.stack([np.interp(at, along, line[:, k]) for k in (0, 1)], axis=1)


def parallel(line: Line, left: Float[Array, "L"] | float) -> Line:
    """The line moved to its left by so many metres."""
    angle = headings(line)
    normal = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    return line + np.reshape(left, (-1, 1)) * normal


def arc(centre: Float[Array, "2"], radius: float, start: float, end: float) -> Line:
    """Points on a circle from one angle to another, either way round."""
    count = max(2, round(abs(end - start) * radius / STEP) + 1)
    angle = np.linspace(start, end, count)
    return centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def joint(
    start: Float[Array, "2"],
    start_heading: float,
    end: Float[Array, "2"],
    end_heading: float,
    *,
    start_bend: float = 0.0,
    end_bend: float = 0.0,
) -> Line:
    """A line from one pose to another that turns as gently as it can.

    A quintic Hermite curve: position, direction and curvature (`bend`, 1/m, to the left) are
    kept at both ends, so that a steering wheel need not jump; of the speeds along the parameter
    the one with the least curvature is taken.
    """
    chord = float(np.hypot(*(end - start)))
    best, least = None, np.inf
    for stretch in np.arange(0.7, 1.75, 0.05):
        speed = stretch * chord
        ends = (start, speed * unit(start_heading), end, speed * unit(end_heading))
        turn = (
            speed**2 * start_bend * left_of(unit(start_heading)),
            speed**2 * end_bend * left_of(unit(end_heading)),
        )
        line = even(_quintic(*ends, *turn))
        worst = float(np.abs(bends(line)).max())
        if worst < least:
            best, least = line, worst
    assert best is not None
    return best


def bends(line: Line) -> Float[Array, "L"]:
    """Curvature at each point, 1/m, positive to the left, of a line with equal steps."""
    angle = headings(line)
    step = run(line)[-1] / max(len(line) - 1, 1)
    return np.gradient(angle) / step


def _quintic(
    start: Array,
    start_speed: Array,
    end: Array,
    end_speed: Array,
    start_turn: Array,
    end_turn: Array,
) -> Line:
    """The quintic polynomial with these values and first and second derivatives at 0 and 1."""
    t = np.linspace(0, 1, 200)[:, None]
    reach = end - start - start_speed - start_turn / 2
    swing = end_speed - start_speed - start_turn
    bend = end_turn - start_turn
    cubic = 10 * reach - 4 * swing + bend / 2
    quartic = -15 * reach + 7 * swing - bend
    quint = 6 * reach - 3 * swing + bend / 2
    return start + t * (
        start_speed + t * (start_turn / 2 + t * (cubic + t * (quartic + t * quint)))
    )
