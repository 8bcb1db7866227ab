"""The kinds of place: where their approaches lie, and what controls the traffic."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from benchmarks.synthetic.roads.approaches import Approach
from geoaim.base.geometry import wrap_angle

PlaceKind = Literal["junction", "t", "roundabout", "street", "park", "campus"]
PLACE_KINDS: tuple[PlaceKind, ...] = get_args(PlaceKind)  # append only: seeds use the index
# kinds with neither private roads nor park footpaths, which the lane map would leave out
STANDARD_KINDS: tuple[PlaceKind, ...] = ("junction", "t", "roundabout", "street")
STREET_KINDS: tuple[PlaceKind, ...] = ("street", "park")  # one road without a junction

CROSSING_WIDTH_M = 4.0  # width along the road, which is the length of a stripe
CYCLE_STRIP_M = 2.4  # strip for cycles between the crossing and the stop line
STOP_SETBACK_M = 1.0  # distance from the crossing or cycle strip to the stop line
PRIVATE_CURVATURE = (0.006, 0.011)  # 1/m, of private roads
RING_LANE_WIDTH_M = 5.4  # width of a roundabout's lane
MAX_CORNER_ANGLE = 0.8 * np.pi  # radians; approaches further apart form one straight road


@dataclass(frozen=True)
class Layout:
    """The approaches of a place and how they meet."""

    kind: PlaceKind  # one of `PLACE_KINDS`
    approaches: tuple[Approach, ...]  # counter-clockwise
    corner_radius: float  # radius of the kerbs where two approaches meet, metres
    # radius of the centreline of a roundabout's lane, metres; 0: no roundabout
    ring_radius: float = 0.0
    signalised: bool = False  # whether traffic lights control it
    # approaches that pedestrians cross where nothing is marked, and metres along them
    informal_crossings: tuple[tuple[str, float], ...] = ()
    # names of approaches through private ground, which lane maps leave out
    private: tuple[str, ...] = ()


def make_layout(kind: PlaceKind, generator: np.random.Generator) -> Layout:
    """Draw a random layout of a kind of place.

    Raises:
        ValueError: the kind is unknown.
    """
    makers: dict[str, Callable[[np.random.Generator], Layout]] = {
        "junction": _make_junction,
        "t": _make_t_junction,
        "roundabout": _make_roundabout,
        "street": _make_street,
        "park": lambda generator: replace(_make_street(generator), kind="park"),
        "campus": _make_campus,
    }
    if kind not in makers:
        raise ValueError(f"kind {kind!r} is not one of {', '.join(PLACE_KINDS)}")
    return makers[kind](generator)


def _make_junction(generator: np.random.Generator) -> Layout:
    """Two roads that cross at traffic lights; the main road has two or three inbound lanes."""
    tilt, skew = generator.uniform(-0.05, 0.05), generator.uniform(-0.18, 0.18)
    main, side = generator.uniform(-0.0022, 0.0022), generator.uniform(-0.003, 0.003)
    lane_width = round(generator.uniform(3.1, 3.4), 2)
    inner_lane = generator.choice(["pocket", "shared"])
    main_turns = ("L", "S", "SR") if inner_lane == "pocket" else ("LS", "SR")
    side_turns = ("L", "SR") if generator.uniform() < 0.7 else ("LSR",)
    east = Approach("east", tilt, main, main_turns, 2, lane_width)
    north = Approach("north", np.pi / 2 + skew, side, side_turns, 1, lane_width, speed_limit=11.1)
    approaches = [
        east,
        north,
        replace(east, name="west", angle=tilt + np.pi, curvature=-main),
        replace(north, name="south", angle=skew - np.pi / 2, curvature=-side),
    ]
    radius = generator.uniform(6.5, 9.0)
    placed = [_place_lines(a, approaches, radius, cycle_strip=CYCLE_STRIP_M) for a in approaches]
    informal = (("south", 40.0),)
    return Layout("junction", tuple(placed), radius, signalised=True, informal_crossings=informal)


def _make_t_junction(generator: np.random.Generator) -> Layout:
    """A side road that gives way to a main road, which one crossing leads over."""
    tilt, skew = generator.uniform(-0.06, 0.06), generator.uniform(-0.2, 0.2)
    main, side = generator.uniform(-0.003, 0.003), generator.uniform(-0.004, 0.004)
    lane_width = round(generator.uniform(3.0, 3.4), 2)
    approaches = [
        Approach("east", tilt, main, ("LS",), 1, lane_width),
        Approach("west", tilt + np.pi, -main, ("SR",), 1, lane_width),
        Approach("south", skew - np.pi / 2, side, ("LR",), 1, lane_width, speed_limit=8.3),
    ]
    radius = generator.uniform(6.0, 8.0)
    east, west, south = (_place_lines(a, approaches, radius, cycle_strip=0.0) for a in approaches)
    marked = "east" if generator.uniform() < 0.5 else "west"
    unmarked = "west" if marked == "east" else "east"
    main_road = (
        replace(a, stop=np.nan, crossing=a.mouth + 1.0 if a.name == marked else np.nan)
        for a in (east, west)
    )
    return Layout("t", (*main_road, south), radius, informal_crossings=((unmarked, 26.0),))


def _make_roundabout(generator: np.random.Generator) -> Layout:
    """Three or four approaches to a roundabout of one lane."""
    radius = generator.uniform(13.5, 16.5)
    tilt, median = generator.uniform(-0.12, 0.12), 2.6
    directions = [("east", 0.0), ("north", np.pi / 2), ("west", np.pi), ("south", -np.pi / 2)]
    if generator.uniform() < 0.35:
        directions.pop(1 if generator.uniform() < 0.5 else 3)
    outer = radius + RING_LANE_WIDTH_M / 2
    mouth = outer + 9.0
    approaches = []
    for name, direction in directions:
        angle = tilt + direction + generator.uniform(-0.12, 0.12)
        road = Approach(name, angle, generator.uniform(-0.003, 0.003), ("LSR",), 1, 3.3, median)
        road = replace(road, mouth=mouth, crossing=mouth + 0.5, stop=outer + 1.0, speed_limit=11.1)
        approaches.append(road)
    informal = (("east", 58.0),)
    return Layout("roundabout", tuple(approaches), 10.0, radius, informal_crossings=informal)


def _make_street(generator: np.random.Generator) -> Layout:
    """One road with a signalised crossing in its middle."""
    tilt, curvature = generator.uniform(-0.08, 0.08), generator.uniform(-0.004, 0.004)
    lanes = int(generator.integers(1, 3))
    stop = CROSSING_WIDTH_M / 2 + 1.5 * STOP_SETBACK_M
    east = Approach("east", tilt, curvature, ("S",) * lanes, lanes, 3.3, mouth=6.0, stop=stop)
    approaches = (
        replace(east, crossing=-CROSSING_WIDTH_M / 2),
        replace(east, name="west", angle=tilt + np.pi, curvature=-curvature),
    )
    informal = (("east", 45.0),)
    return Layout("street", approaches, 6.0, signalised=True, informal_crossings=informal)


def _make_campus(generator: np.random.Generator) -> Layout:
    """A T-junction at a gate: one end of the main road is a winding private road."""
    layout = _make_t_junction(generator)
    curvature = generator.uniform(*PRIVATE_CURVATURE) * (1 if generator.uniform() < 0.5 else -1)
    east, *others = layout.approaches
    approaches = (replace(east, curvature=curvature), *others)
    return replace(layout, kind="campus", approaches=approaches, private=(east.name,))


def locate_corner(approach: Approach, other: Approach) -> float:
    """Locate the corner where the kerbs of two approaches would meet without a corner radius.

    Returns:
        Its distance s along `approach` from the centre, metres; 0 if they do not meet.
    """
    angle = _measure_angle(approach, other)
    if other.name == approach.name or angle > MAX_CORNER_ANGLE:
        return 0.0
    near, far = approach.half_width, other.half_width
    return float((far + near * np.cos(angle)) / np.sin(angle))


def _measure_angle(approach: Approach, other: Approach) -> float:
    """The angle between two approaches, radians in [0, pi]."""
    return float(abs(wrap_angle(np.asarray(other.angle - approach.angle))))


def _place_lines(
    approach: Approach, approaches: list[Approach], corner_radius: float, *, cycle_strip: float
) -> Approach:
    """Place the mouth, crossing and stop line where the corner radii leave room for them."""
    mouth = edge = 0.0
    for other in approaches:
        s = locate_corner(approach, other)
        if s > 0:
            tangent = corner_radius / np.tan(_measure_angle(approach, other) / 2)
            mouth = max(mouth, s + tangent)
            edge = max(edge, s)
    crossing = edge + 0.55 * corner_radius
    stop = crossing + CROSSING_WIDTH_M + cycle_strip + STOP_SETBACK_M
    return replace(approach, mouth=mouth, crossing=crossing, stop=stop)
