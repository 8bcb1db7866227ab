"""Headings of vehicles from their paths: the rear axle follows the middle as a trailer does.

A wheel does not slip sideways, so that a vehicle's rear axle moves along its heading, and not the
middle of its box. With the distance c between them, the heading is that of a trailer whose hitch is
the middle of the box: at each step, the direction from where the axle was to where the middle is.
Headings stay at standstill, since what does not move pulls nothing. In reverse the same holds from
the end backwards in time.
"""

import math

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.base.geometry import wrap_angle

REAR_AXLE_SHARE = 0.3  # distance of the rear axle from the middle of the box, in lengths
MOVING_SPEED = 0.7  # m/s, above which a vehicle certainly moves
MIN_MOVE_M = 1.0  # length of a piece of path that tells in which direction a vehicle faces
MAX_TURN_RAD = 2.1  # a change of direction at a stop by more is a change into or out of reverse
SETTLING_M = 2.5  # of a path whose chord gives its first direction
MIN_FORWARD_M = 3.0  # over which a vehicle drives forward
SLACK_M = 0.3  # by which the middle may come nearer to the rear axle


def follow_rear_axle(
    path: Float[Array, "T 2"], heading: float, distance: float
) -> Float[Array, "T"]:
    """Compute headings (rad) along a path of the box's middle, by the rear axle that follows it.

    The axle is at a distance (m) behind the middle, with a first heading (rad), and pulled as by a
    rope, which may be slack by `SLACK_M`, so that the noise of a standing vehicle does not turn it;
    where the path goes back further, the heading stays.
    """
    headings = np.empty(len(path))
    points = path.tolist()
    slack = max(distance - SLACK_M, distance / 2)
    rear_x = points[0][0] - distance * math.cos(heading)
    rear_y = points[0][1] - distance * math.sin(heading)
    for step, (x, y) in enumerate(points):
        length = math.hypot(x - rear_x, y - rear_y)
        if length < slack:
            rear_x, rear_y = x - slack * math.cos(heading), y - slack * math.sin(heading)
        else:
            heading = math.atan2(y - rear_y, x - rear_x)
            reach = min(length, distance)
            rear_x, rear_y = x - reach * math.cos(heading), y - reach * math.sin(heading)
        headings[step] = heading
    return headings


def compute_headings(
    path: Float[Array, "T 2"],
    velocity: Float[Array, "T 2"],
    length: float,
    facing: float | None = None,
) -> Float[Array, "T"] | None:
    """Compute headings of a vehicle from its smoothed path (m, m/s), in reverse too.

    Where it turns back at a stop, it changes into or out of reverse. In which pieces of its path it
    is in reverse follows from what it is facing before it moves (rad); if that is not known, the
    shorter ones. None for a vehicle that does not move.
    """
    pieces = _find_moving_pieces(path, velocity)
    if not pieces:
        return None
    ends = [_find_end_directions(path[start:stop]) for start, stop in pieces]
    signs = _choose_signs(path, pieces, ends, facing)
    path = _hold_still(path, pieces)
    headings = np.empty(len(path))
    distance = REAR_AXLE_SHARE * length
    current: float | None = None
    for first, last in _group_by_sign(signs):
        start = 0 if first == 0 else (pieces[first - 1][1] + pieces[first][0]) // 2
        is_final = last == len(pieces) - 1
        stop = len(path) if is_final else (pieces[last][1] + pieces[last + 1][0]) // 2
        part = path[start:stop]
        if signs[first] > 0:
            begin = ends[first][0] if current is None else current
            headings[start:stop] = follow_rear_axle(part, begin, distance)
        else:
            facing = ends[last][1] + math.pi
            headings[start:stop] = follow_rear_axle(part[::-1], facing, distance)[::-1]
        current = float(headings[stop - 1])
    return headings


def observe_headings(
    path: Float[Array, "T 2"], length: float, standing: float | None
) -> Float[Array, "T"]:
    """Compute headings (rad) of a vehicle from its path until each time (m).

    They start with what it had while standing; None: with its first move, and are NaN until then.
    """
    distance = REAR_AXLE_SHARE * length
    if standing is not None:
        return follow_rear_axle(path, standing, distance)
    far = np.flatnonzero(np.hypot(*(path - path[0]).T) >= MIN_MOVE_M)
    headings = np.full(len(path), np.nan)
    if len(far):
        begin = int(far[0])
        east, north = path[begin] - path[0]
        headings[begin:] = follow_rear_axle(path[begin:], math.atan2(north, east), distance)
    return headings


def _find_moving_pieces(
    path: Float[Array, "T 2"], velocity: Float[Array, "T 2"]
) -> list[tuple[int, int]]:
    """Find the pieces between stops, as first and last step (exclusive)."""
    moving = np.hypot(*velocity.T) > MOVING_SPEED
    edges = np.flatnonzero(np.diff(np.concatenate([[False], moving, [False]]).astype(int)))
    pieces = [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
    return [
        (start, stop)
        for start, stop in pieces
        if np.hypot(*np.ptp(path[start:stop], axis=0)) >= MIN_MOVE_M
    ]


def _hold_still(path: Float[Array, "T 2"], pieces: list[tuple[int, int]]) -> Float[Array, "T 2"]:
    """Hold a path between its moving pieces, so that the noise of what stands turns nothing."""
    still = path.copy()
    ends = [0, *(edge for piece in pieces for edge in piece), len(path)]
    for stop, start in zip(ends[::2], ends[1::2], strict=True):
        before, after = max(stop - 1, 0), min(start, len(path) - 1)
        if np.hypot(*np.ptp(path[before : after + 1], axis=0)) < MIN_MOVE_M:
            half = stop if stop == 0 else start if start == len(path) else (stop + start) // 2
            still[stop:half], still[half:start] = path[before], path[after]
    return still


def _find_end_directions(path: Float[Array, "T 2"]) -> tuple[float, float]:
    """The directions of motion at the start and at the end of a piece, rad."""
    from_start, to_end = np.hypot(*(path - path[0]).T), np.hypot(*(path[-1] - path).T)
    ahead = path[np.argmax(from_start >= min(SETTLING_M, from_start.max()))] - path[0]
    behind = np.flatnonzero(to_end >= min(SETTLING_M, to_end.max()))[-1]
    back = path[-1] - path[behind]
    return math.atan2(ahead[1], ahead[0]), math.atan2(back[1], back[0])


def _choose_signs(
    path: Float[Array, "T 2"],
    pieces: list[tuple[int, int]],
    ends: list[tuple[float, float]],
    facing: float | None,
) -> Int[Array, " n"]:
    """Choose 1 for pieces driven forward and -1 for those in reverse."""
    signs = np.ones(len(pieces), int)
    for number in range(1, len(pieces)):
        turn = wrap_angle(np.array(ends[number][0] - ends[number - 1][1]))
        signs[number] = signs[number - 1] * (-1 if abs(turn) > MAX_TURN_RAD else 1)
    if facing is not None:
        return signs if np.cos(ends[0][0] - facing) >= 0 else -signs
    lengths = [np.hypot(*np.diff(path[start:stop], axis=0).T).sum() for start, stop in pieces]
    return signs if signs @ np.array(lengths) >= 0 else -signs


def _group_by_sign(signs: Int[Array, " n"]) -> list[tuple[int, int]]:
    """Group successive pieces of one sign, as first and last number."""
    starts = np.flatnonzero(np.diff(signs, prepend=0))
    return list(zip(starts.tolist(), [*(starts[1:] - 1).tolist(), len(signs) - 1], strict=True))
