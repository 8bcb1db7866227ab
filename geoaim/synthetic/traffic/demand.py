"""Who comes when, and by which way: vehicles at the ends of lanes, people at gates."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.synthetic.roads.pedestrian_network import find_route
from geoaim.synthetic.roads.plan import Roads
from geoaim.synthetic.traffic.fleet import STRAIGHT
from geoaim.synthetic.traffic.ways import Way

# share, length, width (m): cars, vans, lorries, buses
VEHICLES = (
    ("car", 0.80, (3.9, 5.0), (1.70, 1.92)),
    ("van", 0.13, (5.0, 6.0), (1.9, 2.1)),
    ("truck", 0.05, (7.0, 9.5), (2.35, 2.5)),
    ("bus", 0.02, (11.8, 12.2), (2.5, 2.55)),
)
CYCLES = 0.12  # share of those who walk or cycle
HASTY = 0.25  # share of those who cross where nothing is marked, if that is shorter
DETOUR = 6.0  # times its length that such a crossing counts for the others


@dataclass(frozen=True)
class Driver:
    """A vehicle that comes.

    Attributes:
        time: seconds.
        way: number of its way.
        kind: "car", "van", "truck" or "bus".
        size: length and width, metres.
        pace: its speed as a share of what is allowed.
        headway: seconds that it keeps.
        phases: where in the waves of its drift within the lane it starts, radians.
    """

    time: float
    way: int
    kind: str
    size: tuple[float, float]
    pace: float
    headway: float
    phases: tuple[float, float]


@dataclass(frozen=True)
class Walker:
    """Somebody on foot or on a cycle who comes.

    Attributes:
        time: seconds.
        kind: "pedestrian" or "cyclist".
        path: (K, 2) points each half metre.
        over: (K,) crossing at each point; -1: none.
        aside: metres to the left of the path.
        pace: m/s.
    """

    time: float
    kind: str
    path: Float[Array, "K 2"]
    over: Int[Array, "K"]
    aside: float
    pace: float


def draw_drivers(
    ways: tuple[Way, ...],
    span: tuple[float, float],
    *,
    rate: float,
    generator: np.random.Generator,
) -> list[list[Driver]]:
    """For each entry, vehicles within a span of time (seconds), in order.

    `rate` is vehicles a second on a lane of the main road that leads straight on; others carry
    their share of it.
    """
    drivers, (start, until) = [], span
    for entry in sorted({way.entry for way in ways if way.entry}):
        mine = [r for r, way in enumerate(ways) if way.entry == entry]
        shares = np.array([ways[r].share for r in mine])
        mean = 1 / (rate * min(shares.sum(), 1.0))
        queue, time = [], start + generator.exponential(mean)
        while time < until:
            way = mine[int(generator.choice(len(mine), p=shares / shares.sum()))]
            queue.append(draw_driver(time, way, ways[way], generator))
            time += generator.exponential(mean)
        drivers.append(queue)
    return drivers


def draw_driver(time: float, number: int, way: Way, generator: np.random.Generator) -> Driver:
    """A vehicle for a way; long ones only where the way is straight."""
    shares = np.array([share for _, share, _, _ in VEHICLES])
    if np.abs(way.bend).max() > 0.02:
        shares = np.array([s * (long[1] < STRAIGHT) for _, s, long, _ in VEHICLES])
    kind, _, length, width = VEHICLES[int(generator.choice(len(VEHICLES), p=shares / shares.sum()))]
    size = round(generator.uniform(*length), 2), round(generator.uniform(*width), 2)
    pace = float(np.clip(generator.normal(0.98, 0.11), 0.7, 1.3))
    phases = generator.uniform(0, 2 * np.pi, 2)
    headway = generator.uniform(0.2, 1.0)
    return Driver(time, number, kind, size, pace, headway, (float(phases[0]), float(phases[1])))


def draw_walkers(
    roads: Roads, span: tuple[float, float], *, rate: float, generator: np.random.Generator
) -> list[Walker]:
    """People within a span of time, in order; `rate` is people a second over the whole place."""
    walkers, (start, until) = [], span
    time = start + generator.exponential(1 / rate)
    while time < until:
        walker = _draw_walker(roads, time, generator)
        if walker is not None:
            walkers.append(walker)
        time += generator.exponential(1 / rate)
    return walkers


def _draw_walker(roads: Roads, time: float, generator: np.random.Generator) -> Walker | None:
    walks = roads.footpaths
    start, end = generator.choice(walks.spawn_nodes, 2, replace=False)
    hasty = generator.uniform() < HASTY
    favour = generator.uniform(0.9, 1.1, len(walks.edges))
    for number, leg in enumerate(walks.edges):
        plain = leg.crossing >= 0 and roads.crossings[leg.crossing].name.endswith("on foot")
        favour[number] *= DETOUR if plain and not hasty else 1.0
    legs = find_route(walks, int(start), int(end), favour)
    if not legs:
        return None
    path = np.concatenate([legs[0][0], *[line[1:] for line, _ in legs[1:]]])
    counts = [len(line) - (k > 0) for k, (line, _) in enumerate(legs)]
    over = np.repeat([crossing for _, crossing in legs], counts)
    cycles = generator.uniform() < CYCLES
    pace = generator.normal(4.3, 0.8) if cycles else generator.normal(1.36, 0.22)
    pace = float(np.clip(pace, 2.6 if cycles else 0.7, 6.0 if cycles else 2.2))
    aside = float(np.clip(generator.normal(-0.25, 0.45), -1.0, 0.9))
    return Walker(time, "cyclist" if cycles else "pedestrian", path, over, aside, pace)
