"""The simulation of a place's traffic: demand, time steps, and what is recorded."""

from dataclasses import dataclass
from math import ceil

import numpy as np
from jaxtyping import Float, Int, Int8
from numpy import ndarray as Array

from benchmarks.synthetic.roads.curves import POINT_SPACING_M
from benchmarks.synthetic.roads.pedestrian_network import find_route
from benchmarks.synthetic.roads.plan import Roads
from benchmarks.synthetic.traffic import spawning
from benchmarks.synthetic.traffic.conflicts import find_conflicts
from benchmarks.synthetic.traffic.driving import step_vehicles
from benchmarks.synthetic.traffic.gap_acceptance import react_to_vehicles
from benchmarks.synthetic.traffic.paths import VehiclePath, make_paths
from benchmarks.synthetic.traffic.pedestrians import (
    CrossingTable,
    PavementMap,
    look_ahead,
    make_pavement_map,
    step_pedestrians,
)
from benchmarks.synthetic.traffic.signals import Signals, compute_light_states, make_signals
from benchmarks.synthetic.traffic.vehicles import (
    PathTables,
    VehicleContext,
    make_path_tables,
    make_vehicle_context,
    place_vehicles,
)

DT = 0.25  # s
LANE_RATE, PEDESTRIAN_RATE = 0.1, 0.16  # a second: on each inbound lane; in the whole place
WARM_UP_S = 30.0  # time before the recording in which the place fills
# share of the open bays that are occupied at the start; how long these vehicles stay on average
PARKED_SHARE, PARKED_S = 0.6, 60.0
WALK_S = 90.0  # about the duration of a pedestrian's trip
MAX_TURNING_LENGTH_M = 6.5  # longer vehicles only drive straight on
MAX_STRAIGHT_CURVATURE = 0.02  # 1/m
CYCLIST_SHARE = 0.12  # share of cyclists among pedestrians and cyclists
JAYWALKER_SHARE = 0.25  # share of those who cross where nothing is marked, if that is shorter
UNMARKED_COST = 6.0  # factor on the length of such a crossing for the others
# share of the traffic; ranges of length and width, metres
VEHICLE_TYPES = {
    "car": (0.80, (3.9, 5.0), (1.70, 1.92)),
    "van": (0.13, (5.0, 6.0), (1.9, 2.1)),
    "truck": (0.05, (7.0, 9.5), (2.35, 2.5)),
    "bus": (0.02, (11.8, 12.2), (2.5, 2.55)),
}


@dataclass(frozen=True, eq=False)
class TrafficModel:
    """What the simulation of a place's traffic needs, computed once."""

    roads: Roads  # the plan
    paths: tuple[VehiclePath, ...]  # paths of vehicles
    tables: PathTables  # tables over these paths
    signals: Signals  # the traffic lights
    pavement: PavementMap  # where pedestrians may walk
    crossings: CrossingTable  # pedestrian crossings


@dataclass(frozen=True, eq=False)
class TrafficRecording:
    """The simulated traffic: one row for each agent and step."""

    times: Float[Array, "T"]  # seconds
    signals: Signals  # the traffic lights during it
    vehicle_trips: tuple[spawning.VehicleTrip, ...]  # trips of all vehicles
    pedestrian_trips: tuple[spawning.PedestrianTrip, ...]  # trips of all pedestrians and cyclists
    vehicle_rows: Int[Array, "V 2"]  # step and index of the trip
    vehicle_paths: Int[Array, "V"]  # index of the path
    vehicle_motion: Float[Array, "V 2"]  # s along the path in metres, and speed in m/s
    pedestrian_rows: Int[Array, "P 2"]  # step and index of the trip
    pedestrian_positions: Float[Array, "P 2"]  # plan metres


def prepare_traffic(roads: Roads, generator: np.random.Generator) -> TrafficModel:
    """Compute all of a place's traffic model; `generator` draws the lights' durations."""
    paths = make_paths(roads)
    signals = make_signals(roads, generator)
    tables = make_path_tables(paths, find_conflicts(roads, paths), signals)
    pavement, crossings = make_pavement_map(roads), _make_crossing_table(roads, signals)
    return TrafficModel(roads, paths, tables, signals, pavement, crossings)


def simulate_traffic(
    model: TrafficModel, *, duration: float, generator: np.random.Generator
) -> TrafficRecording:
    """Simulate the traffic of a place.

    Args:
        model: the result of `prepare_traffic`; `signals.phase` is that at the start of the
            recording.
        duration: seconds.
        generator: generator for everything random.

    Returns:
        The recording, at steps of `DT`, after a warm-up that is left out.
    """
    times = np.arange(-round(WARM_UP_S / DT), ceil(duration / DT - 1e-9) + 1) * DT
    light_states = compute_light_states(model.signals, times)
    interval = -WARM_UP_S, duration
    queues = _draw_vehicle_trips(model.paths, interval, generator)
    trips = spawning.Trips(queues, [], [], [])
    agents = _place_first_agents(model, trips, generator)
    trips.pedestrian_queue.extend(_draw_pedestrian_trips(model.roads, interval, generator))
    context, states = make_vehicle_context(agents.vehicles, model.tables), []
    for time, lights in zip(times.tolist(), light_states, strict=True):
        paths = agents.vehicles.path
        agents = spawning.spawn_agents(agents, trips, model.tables, time, generator)
        if agents.vehicles.path is not paths:
            context = make_vehicle_context(agents.vehicles, model.tables)
        if time > -DT / 2:
            states.append(agents)
        agents = _step(model, agents, context, lights, generator)
    return _make_recording(times[times > -DT / 2], model.signals, states, trips)


def _place_first_agents(
    model: TrafficModel, trips: spawning.Trips, generator: np.random.Generator
) -> spawning.Agents:
    """Park vehicles in some bays, and place pedestrians somewhere on their paths."""
    agents, tables = spawning.make_empty(), model.tables
    vehicles, pedestrians = agents.vehicles, agents.pedestrians
    for bay in np.unique(tables.bay[tables.bay >= 0]):
        path = int(np.argmax((tables.bay == bay) & tables.into_bay))
        trip = _draw_vehicle_trip(-WARM_UP_S, path, model.paths[path], generator)
        parked_until = generator.exponential(PARKED_S)
        if generator.uniform() < PARKED_SHARE:
            s, number = float(tables.length[path]), len(trips.vehicles)
            vehicle = spawning.make_vehicle(trip, number, s=s, parked_until=parked_until)
            vehicles = spawning.concat(vehicles, vehicle)
            trips.vehicles.append(trip)
    trips.pedestrians.extend(_draw_pedestrian_trips(model.roads, (0.0, WALK_S), generator))
    for number, walk in enumerate(trips.pedestrians):
        s = generator.uniform() * POINT_SPACING_M * len(walk.path)
        pedestrians = spawning.concat(pedestrians, spawning.make_pedestrian(walk, number, s))
    return spawning.Agents(vehicles, pedestrians)


def _step(
    model: TrafficModel,
    agents: spawning.Agents,
    context: VehicleContext,
    lights: Int8[Array, "G"],
    generator: np.random.Generator,
) -> spawning.Agents:
    pedestrians, tables, crossings = agents.pedestrians, model.tables, model.crossings
    placed = place_vehicles(agents.vehicles, tables)
    outlook = look_ahead(pedestrians, crossings)
    reaction = react_to_vehicles(pedestrians, outlook, crossings, placed, tables, lights)
    vehicles = step_vehicles(placed, context, tables, lights, outlook.visible, DT)
    noise = generator.standard_normal(pedestrians.position.shape)
    pedestrians = step_pedestrians(pedestrians, outlook, reaction, model.pavement, noise, DT)
    return spawning.Agents(vehicles, pedestrians)


def _make_recording(
    times: Float[Array, "T"], signals: Signals, states: list[spawning.Agents], trips: spawning.Trips
) -> TrafficRecording:
    """Concatenate the states of all steps."""
    vehicles = [state.vehicles for state in states]
    pedestrians = [state.pedestrians for state in states]
    motion = [np.stack([state.s, state.speed], axis=1) for state in vehicles]
    return TrafficRecording(
        times=times,
        signals=signals,
        vehicle_trips=tuple(trips.vehicles),
        pedestrian_trips=tuple(trips.pedestrians),
        vehicle_rows=_number_rows([state.trip for state in vehicles]),
        vehicle_paths=np.concatenate([state.path for state in vehicles]),
        vehicle_motion=np.concatenate(motion),
        pedestrian_rows=_number_rows([state.trip for state in pedestrians]),
        pedestrian_positions=np.concatenate([state.position for state in pedestrians]),
    )


def _number_rows(trips: list[Int[Array, "_"]]) -> Int[Array, "V 2"]:
    steps = np.repeat(np.arange(len(trips)), [len(trip) for trip in trips])
    return np.stack([steps, np.concatenate(trips)], axis=1)


def _make_crossing_table(roads: Roads, signals: Signals) -> CrossingTable:
    """Arrange the crossings of a place in a table."""
    ends = np.array([crossing.ends for crossing in roads.crossings]).reshape(-1, 2, 2)
    across = ends[:, 1] - ends[:, 0]
    length = np.sqrt((across**2).sum(axis=1))
    lights = [f"walk {c.name}" if c.signalised and c.marked else "" for c in roads.crossings]
    indices = {name: k for k, name in enumerate(signals.names)}
    return CrossingTable(
        first=ends[:, 0],
        direction=across / length[:, None],
        signal=np.array([indices.get(name, -1) for name in lights], int),
        marked=np.array([crossing.marked for crossing in roads.crossings]),
        priority=np.array([crossing.name == "drive" for crossing in roads.crossings]),
    )


def _draw_vehicle_trips(
    paths: tuple[VehiclePath, ...], interval: tuple[float, float], generator: np.random.Generator
) -> list[list[spawning.VehicleTrip]]:
    """Draw the trips from each entry in the order of time, as Poisson processes."""
    queues, (start, end) = [], interval
    for entry in sorted({path.entry for path in paths if path.entry}):
        indices = [r for r, path in enumerate(paths) if path.entry == entry]
        shares = np.array([paths[r].share for r in indices])
        mean = 1 / (LANE_RATE * min(shares.sum(), 1.0))
        queue, time = [], start + generator.exponential(mean)
        while time < end:
            index = indices[int(generator.choice(len(indices), p=shares / shares.sum()))]
            queue.append(_draw_vehicle_trip(time, index, paths[index], generator))
            time += generator.exponential(mean)
        queues.append(queue)
    return queues


def _draw_vehicle_trip(
    time: float, index: int, path: VehiclePath, generator: np.random.Generator
) -> spawning.VehicleTrip:
    """Draw a vehicle that departs at a time (s) on a path; long ones only on straight paths."""
    is_curved = np.abs(path.curvature).max() > MAX_STRAIGHT_CURVATURE
    max_length = MAX_TURNING_LENGTH_M if is_curved else np.inf
    table = VEHICLE_TYPES.values()
    shares = np.array([share * (lengths[1] < max_length) for share, lengths, _ in table])
    kind = list(VEHICLE_TYPES)[int(generator.choice(len(shares), p=shares / shares.sum()))]
    _, lengths, widths = VEHICLE_TYPES[kind]
    length, width = generator.uniform(*lengths), generator.uniform(*widths)
    speed_factor = float(np.clip(generator.normal(0.98, 0.11), 0.7, 1.3))
    phases = generator.uniform(0, 2 * np.pi, 2)
    return spawning.VehicleTrip(
        time=time,
        path=index,
        kind=kind,
        size=(round(length, 2), round(width, 2)),
        speed_factor=speed_factor,
        headway=generator.uniform(0.2, 1.0),
        drift_phases=(float(phases[0]), float(phases[1])),
    )


def _draw_pedestrian_trips(
    roads: Roads, interval: tuple[float, float], generator: np.random.Generator
) -> list[spawning.PedestrianTrip]:
    """Draw the trips of pedestrians and cyclists in the order of time, as a Poisson process."""
    trips, (start, end) = [], interval
    time = start + generator.exponential(1 / PEDESTRIAN_RATE)
    while time < end:
        trip = _draw_pedestrian_trip(roads, time, generator)
        if trip is not None:
            trips.append(trip)
        time += generator.exponential(1 / PEDESTRIAN_RATE)
    return trips


def _draw_pedestrian_trip(
    roads: Roads, time: float, generator: np.random.Generator
) -> spawning.PedestrianTrip | None:
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
    return spawning.PedestrianTrip(time, kind, path, crossing, offset, speed)
