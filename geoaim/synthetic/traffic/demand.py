"""Traffic demand: the trips of vehicles from the ends of lanes, and of pedestrians."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.synthetic.roads.pedestrian_network import find_route
from geoaim.synthetic.roads.plan import Roads
from geoaim.synthetic.traffic.paths import VehiclePath

MAX_TURNING_LENGTH_M = 6.5  # longer vehicles only drive straight on
MAX_STRAIGHT_CURVATURE = 0.02  # 1/m
CYCLIST_SHARE = 0.12  # of pedestrians and cyclists
JAYWALKER_SHARE = 0.25  # of those who cross where nothing is marked, if that is shorter
UNMARKED_COST = 6.0  # factor on the length of such a crossing for the others
# share of the traffic; ranges of length and width, metres
VEHICLE_TYPES = {
    "car": (0.80, (3.9, 5.0), (1.70, 1.92)),
    "van": (0.13, (5.0, 6.0), (1.9, 2.1)),
    "truck": (0.05, (7.0, 9.5), (2.35, 2.5)),
    "bus": (0.02, (11.8, 12.2), (2.5, 2.55)),
}


@dataclass(frozen=True)
class VehicleTrip:
    """A vehicle and its driver's parameters.

    Attributes:
        time: of its departure, seconds.
        path: index of its path.
        kind: name of the vehicle type.
        size: length and width, metres.
        speed_factor: its desired speed as a share of the speed limit.
        headway: desired time gap behind others, seconds.
        drift_phases: of the waves in which it drifts within its lane, radians.
    """

    time: float
    path: int
    kind: str
    size: tuple[float, float]
    speed_factor: float
    headway: float
    drift_phases: tuple[float, float]


@dataclass(frozen=True)
class PedestrianTrip:
    """A pedestrian or cyclist and their route.

    Attributes:
        time: of departure, seconds.
        kind: "pedestrian" or "cyclist".
        path: (K, 2) equally spaced points, plan metres.
        crossing: (K,) index of the crossing at each point; -1: none.
        lateral_offset: metres to the left of the path where they prefer to walk.
        desired_speed: m/s.
    """

    time: float
    kind: str
    path: Float[Array, "K 2"]
    crossing: Int[Array, "K"]
    lateral_offset: float
    desired_speed: float


def draw_vehicle_trips(
    paths: tuple[VehiclePath, ...],
    interval: tuple[float, float],
    *,
    rate: float,
    generator: np.random.Generator,
) -> list[list[VehicleTrip]]:
    """Draw the trips of vehicles as Poisson processes.

    Args:
        paths: of vehicles.
        interval: of departures, seconds.
        rate: vehicles a second on a lane of the main road; other lanes carry a share of it.
        generator: of the trips.

    Returns:
        The trips from each entry, in the order of time.
    """
    queues, (start, end) = [], interval
    for entry in sorted({path.entry for path in paths if path.entry}):
        indices = [r for r, path in enumerate(paths) if path.entry == entry]
        shares = np.array([paths[r].share for r in indices])
        mean = 1 / (rate * min(shares.sum(), 1.0))
        queue, time = [], start + generator.exponential(mean)
        while time < end:
            index = indices[int(generator.choice(len(indices), p=shares / shares.sum()))]
            queue.append(draw_vehicle_trip(time, index, paths[index], generator))
            time += generator.exponential(mean)
        queues.append(queue)
    return queues


def draw_vehicle_trip(
    time: float, index: int, path: VehiclePath, generator: np.random.Generator
) -> VehicleTrip:
    """Draw a vehicle; long ones only on straight paths.

    Args:
        time: of its departure, seconds.
        index: of the path.
        path: of the vehicle.
        generator: of the trip.

    Returns:
        The trip.
    """
    is_curved = np.abs(path.curvature).max() > MAX_STRAIGHT_CURVATURE
    max_length = MAX_TURNING_LENGTH_M if is_curved else np.inf
    table = VEHICLE_TYPES.values()
    shares = np.array([share * (lengths[1] < max_length) for share, lengths, _ in table])
    kind = list(VEHICLE_TYPES)[int(generator.choice(len(shares), p=shares / shares.sum()))]
    _, lengths, widths = VEHICLE_TYPES[kind]
    length, width = generator.uniform(*lengths), generator.uniform(*widths)
    speed_factor = float(np.clip(generator.normal(0.98, 0.11), 0.7, 1.3))
    phases = generator.uniform(0, 2 * np.pi, 2)
    return VehicleTrip(
        time=time,
        path=index,
        kind=kind,
        size=(round(length, 2), round(width, 2)),
        speed_factor=speed_factor,
        headway=generator.uniform(0.2, 1.0),
        drift_phases=(float(phases[0]), float(phases[1])),
    )


def draw_pedestrian_trips(
    roads: Roads, interval: tuple[float, float], *, rate: float, generator: np.random.Generator
) -> list[PedestrianTrip]:
    """Draw the trips of pedestrians and cyclists as a Poisson process.

    Args:
        roads: the plan.
        interval: of departures, seconds.
        rate: pedestrians a second in the whole place.
        generator: of the trips.

    Returns:
        The trips in the order of time.
    """
    trips, (start, end) = [], interval
    time = start + generator.exponential(1 / rate)
    while time < end:
        trip = _draw_pedestrian_trip(roads, time, generator)
        if trip is not None:
            trips.append(trip)
        time += generator.exponential(1 / rate)
    return trips


def _draw_pedestrian_trip(
    roads: Roads, time: float, generator: np.random.Generator
) -> PedestrianTrip | None:
    """A trip between two spawn nodes; None if there is no route."""
    network = roads.footpaths
    start, end = generator.choice(network.spawn_nodes, 2, replace=False)
    jaywalks = generator.uniform() < JAYWALKER_SHARE
    factors = generator.uniform(0.9, 1.1, len(network.edges))
    for number, edge in enumerate(network.edges):
        informal = edge.crossing >= 0 and roads.crossings[edge.crossing].name.endswith("on foot")
        factors[number] *= UNMARKED_COST if informal and not jaywalks else 1.0
    route = find_route(network, int(start), int(end), factors)
    if not route:
        return None
    path = np.concatenate([route[0][0], *[line[1:] for line, _ in route[1:]]])
    counts = [len(line) - (k > 0) for k, (line, _) in enumerate(route)]
    crossing = np.repeat([crossing for _, crossing in route], counts)
    cycles = generator.uniform() < CYCLIST_SHARE
    mean, spread, slowest, fastest = (4.3, 0.8, 2.6, 6.0) if cycles else (1.36, 0.22, 0.7, 2.2)
    speed = float(np.clip(generator.normal(mean, spread), slowest, fastest))  # m/s
    offset = float(np.clip(generator.normal(-0.25, 0.45), -1.0, 0.9))
    kind = "cyclist" if cycles else "pedestrian"
    return PedestrianTrip(time, kind, path, crossing, offset, speed)
