"""From a recording to tracks: poses of bodies at any times."""

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.geometry import wrap_angle
from geoaim.synthetic.roads.curves import POINT_SPACING_M, compute_arc_lengths
from geoaim.synthetic.traffic.fleet import NOSE, TAIL
from geoaim.synthetic.traffic.simulate import INTERVAL, Flow, Recording
from geoaim.synthetic.traffic.ways import Way
from geoaim.tracks import Tracks, estimate_heading
from geoaim.world import World

MIDDLE = (NOSE - TAIL) / 2  # share of the length from the rear axle to the box's middle
WANDER = ((37.0, 0.45), (83.0, 0.55))  # m, share: drivers drift in their lane in waves
SWAY = 0.22  # m for each metre that a lane of this width leaves
LANE = 2.9  # m
SIZE = {"pedestrian": (0.5, 0.6), "cyclist": (1.8, 0.65)}  # m
STANDING = 0.5  # m/s under which one keeps one's heading


def replay(
    flow: Flow,
    recording: Recording,
    world_from_plan: Float[Array, "3 3"],
    world: World,
    *,
    times: Float[Array, "T"],
    margin: float = 0.0,
) -> Tracks:
    """Tracks of all whose middle is on the page or within a margin (metres) of it.

    Vehicles are exact: the rear axle lies on its way, wandering a little in its lane, in the
    direction of a kinematic bicycle; between steps it moves by the cubic that has the speeds of
    both. The speed is that of the box's middle.

    Raises:
        ValueError: a time lies outside of the recording.
    """
    if times[0] < recording.times[0] or times[-1] > recording.times[-1] + 1e-9:
        first, last = recording.times[[0, -1]]
        raise ValueError(
            f"times run from {times[0]:g} to {times[-1]:g}; there are {first:g} to {last:g} s"
        )
    vehicles = _vehicle_states(flow, recording, times)
    people = _people_states(recording, times)
    states = np.concatenate([vehicles, people])
    states[~_on_page(flow, states, margin)] = np.nan
    turn = float(np.arctan2(world_from_plan[1, 0], world_from_plan[0, 0]))
    states[..., :2] = states[..., :2] @ world_from_plan[:2, :2].T + world_from_plan[:2, 2]
    states[..., 2] = wrap_angle(states[..., 2] + turn)
    present = np.isfinite(states).all(axis=-1)
    kinds = [d.kind for d in recording.drivers] + [w.kind for w in recording.walkers]
    sizes = [d.size for d in recording.drivers] + [SIZE[w.kind] for w in recording.walkers]
    seen = present.any(axis=1)
    return Tracks(
        times=np.asarray(times, np.float64),
        states=states[seen],
        present=present[seen],
        sizes=np.array(sizes, np.float64).reshape(-1, 2)[seen],
        types=tuple(kind for kind, there in zip(kinds, seen, strict=True) if there),
        ids=tuple(str(k) for k in np.flatnonzero(seen)),
        world=world,
    )


def _on_page(flow: Flow, states: Float[Array, "N T 4"], margin: float) -> Array:
    left, low, right, high = flow.roads.extent.buffer(margin).bounds
    x, y = states[..., 0], states[..., 1]
    return (x > left) & (x < right) & (y > low) & (y < high)


def _dense(
    rows: Int[Array, "V 2"], values: Float[Array, "V c"], agents: int, steps: int
) -> Float[Array, "N T c"]:
    table = np.full((agents, steps, values.shape[1]), np.nan)
    table[rows[:, 1], rows[:, 0]] = values
    return table


def _between(
    recording: Recording, times: Float[Array, "T"]
) -> tuple[Int[Array, "T"], Float[Array, "T"]]:
    """The step before each time, and the share of the interval since then."""
    at = (np.asarray(times) - recording.times[0]) / INTERVAL
    before = np.clip(np.floor(at + 1e-9).astype(int), 0, len(recording.times) - 2)
    return before, at - before


def _cubic(
    start: Array, end: Array, slope: Array, end_slope: Array, t: Array
) -> tuple[Array, Array]:
    """Hermite's cubic and its derivative by time at a share t of the interval."""
    d, a, b = end - start, slope * INTERVAL, end_slope * INTERVAL
    place = start + t * (a + t * (3 * d - 2 * a - b + t * (a + b - 2 * d)))
    return place, (a + t * (6 * d - 4 * a - 2 * b + 3 * t * (a + b - 2 * d))) / INTERVAL


def _vehicle_states(
    flow: Flow, recording: Recording, times: Float[Array, "T"]
) -> Float[Array, "N T 4"]:
    agents, steps = len(recording.drivers), len(recording.times)
    values = np.column_stack([recording.way, recording.along])
    table = _dense(recording.vehicles, values, agents, steps)
    before, t = _between(recording, times)
    start, end = table[:, before], table[:, before + 1]
    same = (start[..., 0] == end[..., 0]) | np.isnan(start[..., 0])
    start = np.where(same[..., None], start, end)  # who leaves a bay stood there until then
    at, speed = _cubic(start[..., 1], end[..., 1], start[..., 2], end[..., 2], t)
    at = np.where(same, at, end[..., 1])
    speed = np.where(same, speed, 0.0)
    states = np.full((agents, len(times), 4), np.nan)
    present = np.isfinite(at)
    agent = np.nonzero(present)[0]
    way = start[..., 0][present].astype(int)
    states[present] = _poses(flow.ways, recording, agent, way, at[present], speed[present])
    return states


def _poses(
    ways: tuple[Way, ...], recording: Recording, agent: Array, way: Array, at: Array, speed: Array
) -> Float[Array, "V 4"]:
    """Middle, heading and speed of bodies whose rear axles are at metres of their ways."""
    table = _table(ways)
    index = np.minimum((at / POINT_SPACING_M).astype(int), table.shape[1] - 2)
    share = (at / POINT_SPACING_M - index)[:, None]
    near, far = table[way, index], table[way, index + 1]
    x, y, heading, bend, stretch = ((1 - share) * near + share * far)[:, :5].T
    forward = table[way, np.rint(at / POINT_SPACING_M).astype(int), 5] > 0
    course = np.where(forward, heading, heading - np.pi)
    drivers = recording.drivers
    length = np.array([driver.size[0] for driver in drivers])[agent]
    aside, slope, curl = _wander(recording, agent, at, np.array([w.bay for w in ways])[way] < 0)
    x, y = x - aside * np.sin(course), y + aside * np.cos(course)
    ahead = 1 - bend * aside
    course = course + np.arctan2(slope, ahead)
    speed = speed * stretch * np.sqrt(ahead**2 + slope**2)
    bend = bend / ahead + curl
    heading = np.where(forward, course, course + np.pi)
    reach = MIDDLE * length
    middle = np.stack([x + reach * np.cos(heading), y + reach * np.sin(heading)])
    speed = np.where(forward, speed, -speed) * np.sqrt(1 + (reach * bend) ** 2)
    return np.column_stack([*middle, heading, speed])


def _table(ways: tuple[Way, ...]) -> Float[Array, "R K 6"]:
    """x, y, heading, curvature, metres for each metre of count, and forward, for all ways.

    The heading of the body turns evenly where the motion turns round.
    """
    longest = max(len(way.line) for way in ways) + 1
    table = np.empty((len(ways), longest, 6))
    for r, way in enumerate(ways):
        steps = np.diff(compute_arc_lengths(way.line), append=np.nan) / POINT_SPACING_M
        steps[-1] = steps[-2]
        heading = np.unwrap(way.heading + np.where(way.forward, 0.0, np.pi))
        columns = [way.line, heading, way.bend, steps, way.forward]
        rows = np.column_stack(columns).astype(np.float64)
        table[r] = rows[np.minimum(np.arange(longest), len(rows) - 1)]
    return table


def _wander(
    recording: Recording, agent: Array, at: Array, free: Array
) -> tuple[Array, Array, Array]:
    """Metres to the left of the way, and its first and second derivative by metre."""
    width = np.array([driver.size[1] for driver in recording.drivers])
    phase = np.array([driver.phases for driver in recording.drivers])[agent]
    size = np.where(free, SWAY * (LANE - width)[agent], 0.0)
    waves = []
    for order in range(3):
        total = np.zeros(len(at))
        for k, (length, share) in enumerate(WANDER):
            pulse = 2 * np.pi / length
            total += share * pulse**order * np.sin(pulse * at + phase[:, k] + order * np.pi / 2)
        waves.append(size * total)
    return waves[0], waves[1], waves[2]


def _people_states(recording: Recording, times: Float[Array, "T"]) -> Float[Array, "N T 4"]:
    """Between steps people move by the cubic that passes through both as it does its neighbours."""
    agents, steps = len(recording.walkers), len(recording.times)
    places = _dense(recording.people, recording.places, agents, steps)
    ahead = np.diff(places, axis=1) / INTERVAL
    gap = np.full((agents, 1, 2), np.nan)
    after, before = np.concatenate([ahead, gap], axis=1), np.concatenate([gap, ahead], axis=1)
    slope = np.where(
        np.isnan(after), before, np.where(np.isnan(before), after, (after + before) / 2)
    )
    step, t = _between(recording, times)
    ends = places[:, step], places[:, step + 1], slope[:, step], slope[:, step + 1]
    place, speed = _cubic(*ends, t[:, None])
    heading = estimate_heading(speed, min_speed=STANDING)
    fast = np.hypot(speed[..., 0], speed[..., 1])
    return np.concatenate([place, heading[..., None], fast[..., None]], axis=-1)
