"""A recording of the traffic of a place: the loop over time."""

from dataclasses import dataclass
from math import ceil

import cv2
import numpy as np
import shapely
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.synthetic.roads.curves import POINT_SPACING_M
from geoaim.synthetic.roads.plan import Roads
from geoaim.synthetic.traffic.comings import (
    enter,
    join,
    leave_bay,
    leave_plan,
    nobody,
    park,
    pick,
    step_in,
    vehicle,
)
from geoaim.synthetic.traffic.crowd import (
    Crossings,
    Crowd,
    Ground,
    look_ahead,
    mind_traffic,
    stepping,
    walk,
)
from geoaim.synthetic.traffic.demand import Driver, Walker, draw_driver, draw_drivers, draw_walkers
from geoaim.synthetic.traffic.fleet import Fleet, Rules, make_rules, pair_up, reach_of, step
from geoaim.synthetic.traffic.overlaps import find_overlaps
from geoaim.synthetic.traffic.signals import Signals, lights_at, plan_signals
from geoaim.synthetic.traffic.ways import Way, make_ways

INTERVAL = 0.25  # s
EARLY = 30.0  # s before the recording, in which the place fills
CELL = 0.25  # m of the raster of the pavements
FULL = 0.6  # share of the open bays in which somebody stands at first
STANDS = 60.0  # s, mean time that he goes on standing there
WALK = 90.0  # s, about how long somebody is on his way
NEAR = 0.6  # m from its end where a walk is over


@dataclass(frozen=True, eq=False)
class Flow:
    """What the traffic of a place needs, worked out once.

    Attributes:
        roads: the plan.
        ways: of vehicles.
        rules: tables over the ways.
        signals: lights.
        ground: where people may stand.
        crossings: as people see them.
    """

    roads: Roads
    ways: tuple[Way, ...]
    rules: Rules
    signals: Signals
    ground: Ground
    crossings: Crossings


@dataclass(frozen=True, eq=False)
class Recording:
    """What happened: one row for each agent and step.

    Attributes:
        times: (T,) seconds.
        signals: the lights during it.
        drivers: all vehicles, in the order of their numbers.
        walkers: all people.
        vehicles: (V, 2) step and number of the vehicle.
        way: (V,) number of its way.
        along: (V, 2) metres along the way and m/s.
        people: (P, 2) step and number of the person.
        places: (P, 2) plan metres.
    """

    times: Float[Array, "T"]
    signals: Signals
    drivers: tuple[Driver, ...]
    walkers: tuple[Walker, ...]
    vehicles: Int[Array, "V 2"]
    way: Int[Array, "V"]
    along: Float[Array, "V 2"]
    people: Int[Array, "P 2"]
    places: Float[Array, "P 2"]


def prepare_traffic(roads: Roads, generator: np.random.Generator) -> Flow:
    """Work out ways, overlaps, lights and pavements of a plan."""
    ways = make_ways(roads)
    signals = plan_signals(roads, generator)
    overlaps = find_overlaps(ways, roads.crossings, ring=roads.layout.ring_radius > 0)
    rules = make_rules(ways, overlaps, signals)
    return Flow(roads, ways, rules, signals, _ground(roads), _crossings(roads, signals))


def record(
    flow: Flow,
    *,
    seconds: float,
    generator: np.random.Generator,
    lane_rate: float = 0.1,
    walk_rate: float = 0.16,
) -> Recording:
    """Let the traffic run.

    Args:
        flow: from `prepare_traffic`.
        seconds: length of the recording; the place fills before it.
        generator: of who comes when.
        lane_rate: vehicles a second on each lane towards the middle.
        walk_rate: people a second over the whole place.
    """
    times = np.arange(-round(EARLY / INTERVAL), ceil(seconds / INTERVAL - 1e-9) + 1) * INTERVAL
    lights = lights_at(flow.signals, times)
    span = -EARLY, seconds
    demand = draw_drivers(flow.ways, span, rate=lane_rate, generator=generator)
    fleet, drivers = _first_vehicles(flow, generator)
    crowd, walkers = _first_people(flow, walk_rate, generator)
    people = draw_walkers(flow.roads, span, rate=walk_rate, generator=generator)
    pairs, moments = pair_up(fleet, flow.rules), []
    for time, light in zip(times.tolist(), lights, strict=True):
        before = fleet
        fleet = leave_bay(park(fleet, flow.rules, time, generator), flow.rules, time, generator)
        fleet = leave_plan(fleet, flow.rules)
        for queue in demand:
            if queue and queue[0].time <= time:
                more = enter(fleet, flow.rules, queue[0], len(drivers))
                if more is not fleet:
                    fleet, drivers = more, [*drivers, queue.pop(0)]
        while people and people[0].time <= time:
            crowd = step_in(crowd, people[0], len(walkers))
            walkers.append(people.pop(0))
        arrived = crowd.done >= POINT_SPACING_M * crowd.last - NEAR
        crowd = pick(crowd, ~arrived) if arrived.any() else crowd
        if fleet.way is not before.way:
            pairs = pair_up(fleet, flow.rules)
        if time > -INTERVAL / 2:
            moments.append((fleet, crowd))
        vehicles = fleet, *reach_of(fleet, flow.rules)
        outlook = look_ahead(crowd, flow.crossings)
        on_foot = stepping(crowd, outlook, flow.crossings)
        minded = mind_traffic(crowd, outlook, flow.crossings, vehicles, flow.rules, light)
        fleet = step(vehicles, pairs, flow.rules, light, on_foot, INTERVAL)
        sway = generator.standard_normal(crowd.place.shape)
        crowd = walk(crowd, outlook, flow.ground, minded, sway, INTERVAL)
    during = times[times > -INTERVAL / 2]
    return _collected(during, flow.signals, moments, drivers, walkers)


def _first_vehicles(flow: Flow, generator: np.random.Generator) -> tuple[Fleet, list[Driver]]:
    """Those who stand in some bays from the start."""
    fleet, rules = nobody()[0], flow.rules
    drivers: list[Driver] = []
    for bay in np.unique(rules.bay[rules.bay >= 0]):
        way = int(np.argmax((rules.bay == bay) & rules.inwards))
        driver = draw_driver(-EARLY, way, flow.ways[way], generator)
        leaves = generator.exponential(STANDS)
        if generator.uniform() < FULL:
            at = float(rules.finish[way])
            fleet = join(fleet, vehicle(driver, len(drivers), way=way, at=at, leaves=leaves))
            drivers.append(driver)
    return fleet, drivers


def _first_people(
    flow: Flow, rate: float, generator: np.random.Generator
) -> tuple[Crowd, list[Walker]]:
    """Those who are somewhere on their walks at the start."""
    crowd = nobody()[1]
    walkers = draw_walkers(flow.roads, (0.0, WALK), rate=rate, generator=generator)
    for number, walker in enumerate(walkers):
        done = generator.uniform() * POINT_SPACING_M * len(walker.path)
        crowd = step_in(crowd, walker, number, done)
    return crowd, walkers


def _collected(
    times: Array,
    signals: Signals,
    moments: list[tuple[Fleet, Crowd]],
    drivers: list[Driver],
    walkers: list[Walker],
) -> Recording:
    fleets, crowds = [fleet for fleet, _ in moments], [crowd for _, crowd in moments]
    steps = np.arange(len(moments))
    vehicles = np.repeat(steps, [len(fleet.at) for fleet in fleets])
    people = np.repeat(steps, [len(crowd.done) for crowd in crowds])
    return Recording(
        times=times,
        signals=signals,
        drivers=tuple(drivers),
        walkers=tuple(walkers),
        vehicles=np.stack([vehicles, np.concatenate([f.number for f in fleets])], axis=1),
        way=np.concatenate([fleet.way for fleet in fleets]),
        along=np.concatenate([np.stack([f.at, f.speed], axis=1) for f in fleets]),
        people=np.stack([people, np.concatenate([c.number for c in crowds])], axis=1),
        places=np.concatenate([crowd.place for crowd in crowds]),
    )


def _ground(roads: Roads) -> Ground:
    """The pavements as a raster of distances."""
    paving = roads.paving
    allowed = shapely.union_all([paving.pavement, paving.drive, roads.footpaths.surface])
    left, low, right, high = roads.extent.buffer(12.0).bounds
    shape = round((high - low) / CELL), round((right - left) / CELL)
    mask = np.zeros(shape, np.uint8)
    for part in shapely.get_parts(allowed):
        rings = [part.exterior, *part.interiors]
        corners = [_cells(np.array(ring.coords), (left, low)) for ring in rings]
        cv2.fillPoly(mask, corners, 1)
    inside = CELL * cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    inside = np.round(inside.astype(np.float64), 6)
    smooth = np.round(cv2.GaussianBlur(inside, (0, 0), 1.0), 4)
    rise, right_rise = np.gradient(smooth)
    steep = np.sqrt(rise**2 + right_rise**2).clip(1e-6)
    table = np.stack([inside, right_rise / steep, rise / steep], axis=-1)
    return Ground(np.round(table, 4), np.array([left, low]), CELL)


def _cells(ring: Array, corner: tuple[float, float]) -> Array:
    return np.rint((ring - corner) / CELL - 0.5).astype(np.int32)


def _crossings(roads: Roads, signals: Signals) -> Crossings:
    ends = np.array([crossing.ends for crossing in roads.crossings]).reshape(-1, 2, 2)
    across = ends[:, 1] - ends[:, 0]
    length = np.sqrt((across**2).sum(axis=1))
    names = [f"walk {c.name}" if c.signalised and c.marked else "" for c in roads.crossings]
    return Crossings(
        first=ends[:, 0],
        ahead=across / length[:, None],
        light=np.array([signals.names.index(n) if n in signals.names else -1 for n in names], int),
        marked=np.array([crossing.marked for crossing in roads.crossings]),
        free=np.array([crossing.name == "drive" for crossing in roads.crossings]),
    )
