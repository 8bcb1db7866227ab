"""From a recording of simulated traffic to tracks at any times."""

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from benchmarks.synthetic.place import Place
from benchmarks.synthetic.roads.curves import POINT_SPACING_M, compute_arc_lengths
from benchmarks.synthetic.traffic.paths import VehiclePath
from benchmarks.synthetic.traffic.simulate import DT, TrafficModel, TrafficRecording
from benchmarks.synthetic.traffic.vehicles import FRONT_SHARE, REAR_SHARE
from geoaim.base.geometry import wrap_angle
from geoaim.tracks.tracks import Tracks, estimate_heading

# distance from rear axle to box centre, in lengths of the vehicle
CENTRE_SHARE = (FRONT_SHARE - REAR_SHARE) / 2
DRIFT_WAVES = ((37.0, 0.45), (83.0, 0.55))  # wavelength in metres, share of the amplitude
DRIFT_AMPLITUDE, DRIFT_LANE_WIDTH_M = 0.22, 2.9  # amplitude for each metre of free width in a lane
BOX_SIZE_M = {"pedestrian": (0.5, 0.6), "cyclist": (1.8, 0.65)}
MIN_HEADING_SPEED = 0.5  # m/s of pedestrians, below which they keep their heading


def interpolate_tracks(
    model: TrafficModel,
    recording: TrafficRecording,
    place: Place,
    *,
    times: Float[Array, "T"],
    margin: float = 0.0,
) -> Tracks:
    """Interpolate the tracks of a recording.

    A vehicle moves as a kinematic bicycle whose rear axle follows its path with a slow drift in the
    lane; its distance along the path is a cubic of time between the steps of the simulation. The
    speed in the tracks is that of the box centre.

    Args:
        model: the traffic model of the place.
        recording: recording of that model's traffic.
        place: the place, for the transform to the world.
        times: (T,) times within the recording, seconds.
        margin: metres around the drawn extent in which agents are present.

    Returns:
        The tracks of all agents that are present at any time.

    Raises:
        ValueError: a time lies outside the recording.
    """
    if times[0] < recording.times[0] or times[-1] > recording.times[-1] + 1e-9:
        asked, given = (f"from {t[0]:g} to {t[-1]:g} s" for t in (times, recording.times))
        raise ValueError(f"times are {asked}; the recording is {given}")
    vehicles = _interpolate_vehicles(model, recording, times)
    states = np.concatenate([vehicles, _interpolate_pedestrians(recording, times)])
    left, bottom, right, top = model.roads.extent.buffer(margin).bounds
    x, y = states[..., 0], states[..., 1]
    states[~((x > left) & (x < right) & (y > bottom) & (y < top))] = np.nan
    matrix = place.world_from_plan
    states[..., 2] = wrap_angle(states[..., 2] + float(np.arctan2(matrix[1, 0], matrix[0, 0])))
    states[..., :2] = states[..., :2] @ matrix[:2, :2].T + matrix[:2, 2]
    present = np.isfinite(states).all(axis=-1)
    kept = np.flatnonzero(present.any(axis=1))
    agents = [(trip.kind, trip.size) for trip in recording.vehicle_trips]
    agents += [(trip.kind, BOX_SIZE_M[trip.kind]) for trip in recording.pedestrian_trips]
    return Tracks(
        times=np.asarray(times, np.float64),
        states=states[kept],
        present=present[kept],
        sizes=np.array([agents[k][1] for k in kept], np.float64).reshape(-1, 2),
        types=tuple(agents[k][0] for k in kept),
        ids=tuple(str(k) for k in kept),
        world=place.world,
    )


def _spread(
    rows: Int[Array, "V 2"], values: Float[Array, "V c"], agents: int, steps: int
) -> Float[Array, "N T c"]:
    """A table over agents and steps of values in rows (step, agent); NaN elsewhere."""
    table = np.full((agents, steps, values.shape[1]), np.nan)
    table[rows[:, 1], rows[:, 0]] = values
    return table


def _locate_steps(
    recording: TrafficRecording, times: Float[Array, "T"]
) -> tuple[Int[Array, "T"], Float[Array, "T"]]:
    """The step before each time, and the share of the time step since then."""
    position = (np.asarray(times) - recording.times[0]) / DT
    before = np.clip(np.floor(position + 1e-9).astype(int), 0, len(recording.times) - 2)
    return before, position - before


def _interpolate_cubic(
    values: tuple[Array, Array], slopes: tuple[Array, Array], t: Float[Array, "*T"]
) -> tuple[Array, Array]:
    """The cubic between values with slopes, at a share t of the time step, and its slope there."""
    change, a, b = values[1] - values[0], slopes[0] * DT, slopes[1] * DT
    value = values[0] + t * (a + t * (3 * change - 2 * a - b + t * (a + b - 2 * change)))
    return value, (a + t * (6 * change - 4 * a - 2 * b + 3 * t * (a + b - 2 * change))) / DT


def _interpolate_vehicles(
    model: TrafficModel, recording: TrafficRecording, times: Float[Array, "T"]
) -> Float[Array, "N T 4"]:
    """The box centre, heading and speed of all vehicles in the plan; NaN where absent."""
    agents, steps = len(recording.vehicle_trips), len(recording.times)
    values = np.column_stack([recording.vehicle_paths, recording.vehicle_motion])
    table = _spread(recording.vehicle_rows, values, agents, steps)
    before, t = _locate_steps(recording, times)
    start, end = table[:, before], table[:, before + 1]
    same_path = (start[..., 0] == end[..., 0]) | np.isnan(start[..., 0])
    # vehicles stand there before they leave a bay
    start = np.where(same_path[..., None], start, end)
    s, speed = _interpolate_cubic((start[..., 1], end[..., 1]), (start[..., 2], end[..., 2]), t)
    s, speed = np.where(same_path, s, end[..., 1]), np.where(same_path, speed, 0.0)
    states = np.full((agents, len(times), 4), np.nan)
    present = np.isfinite(s)
    agent = np.nonzero(present)[0]
    path = start[..., 0][present].astype(int)
    motion = s[present], speed[present]
    states[present] = _compute_poses(model.paths, recording, agent, path, motion)
    return states


def _compute_poses(
    paths: tuple[VehiclePath, ...],
    recording: TrafficRecording,
    agent: Int[Array, "V"],
    path: Int[Array, "V"],
    motion: tuple[Float[Array, "V"], Float[Array, "V"]],
) -> Float[Array, "V 4"]:
    """The box centre, heading and speed of vehicles whose rear axles have some s and speed."""
    (s, speed), table = motion, _make_pose_table(paths)
    index = np.minimum((s / POINT_SPACING_M).astype(int), table.shape[1] - 2)
    share = (s / POINT_SPACING_M - index)[:, None]
    near, far = table[path, index], table[path, index + 1]
    x, y, heading, curvature, stretch = ((1 - share) * near + share * far)[:, :5].T
    forward = table[path, np.rint(s / POINT_SPACING_M).astype(int), 5] > 0
    course = np.where(forward, heading, heading - np.pi)
    on_road = np.array([path.bay for path in paths])[path] < 0
    offset, slope, bend = _compute_drift(recording, agent, s, on_road)
    x, y = x - offset * np.sin(course), y + offset * np.cos(course)
    scale = 1 - curvature * offset
    course = course + np.arctan2(slope, scale)
    speed = speed * stretch * np.sqrt(scale**2 + slope**2)
    curvature = curvature / scale + bend
    heading = np.where(forward, course, course + np.pi)
    to_centre = CENTRE_SHARE * np.array([trip.size[0] for trip in recording.vehicle_trips])[agent]
    x, y = x + to_centre * np.cos(heading), y + to_centre * np.sin(heading)
    speed = np.where(forward, speed, -speed) * np.sqrt(1 + (to_centre * curvature) ** 2)
    return np.column_stack([x, y, heading, speed])


def _make_pose_table(paths: tuple[VehiclePath, ...]) -> Float[Array, "R K 6"]:
    """At all points of paths: x, y, body heading, curvature, metres a metre of s, forward."""
    longest = max(len(path.line) for path in paths) + 1
    table = np.empty((len(paths), longest, 6))
    for r, path in enumerate(paths):
        stretch = np.diff(compute_arc_lengths(path.line), append=np.nan) / POINT_SPACING_M
        stretch[-1] = stretch[-2]
        heading = np.unwrap(path.heading + np.where(path.forward, 0.0, np.pi))
        columns = [path.line, heading, path.curvature, stretch, path.forward]
        rows = np.column_stack(columns).astype(np.float64)
        table[r] = rows[np.minimum(np.arange(longest), len(rows) - 1)]
    return table


def _compute_drift(
    recording: TrafficRecording,
    agent: Int[Array, "V"],
    s: Float[Array, "V"],
    on_road: Bool[Array, "V"],
) -> tuple[Float[Array, "V"], Float[Array, "V"], Float[Array, "V"]]:
    """The drift to the left of the path in metres, and its two derivatives along the path."""
    width = np.array([trip.size[1] for trip in recording.vehicle_trips])
    phases = np.array([trip.drift_phases for trip in recording.vehicle_trips])[agent]
    room = (DRIFT_LANE_WIDTH_M - width)[agent]
    amplitude = np.where(on_road, DRIFT_AMPLITUDE * room, 0.0)
    derivatives = []
    for order in range(3):
        total = np.zeros(len(s))
        for k, (wavelength, share) in enumerate(DRIFT_WAVES):
            frequency = 2 * np.pi / wavelength
            angle = frequency * s + phases[:, k] + order * np.pi / 2
            total += share * frequency**order * np.sin(angle)
        derivatives.append(amplitude * total)
    return derivatives[0], derivatives[1], derivatives[2]


def _interpolate_pedestrians(
    recording: TrafficRecording, times: Float[Array, "T"]
) -> Float[Array, "N T 4"]:
    """Positions, headings and speeds of all pedestrians; cubic, with slopes between neighbours."""
    agents, steps = len(recording.pedestrian_trips), len(recording.times)
    rows, positions = recording.pedestrian_rows, recording.pedestrian_positions
    positions = _spread(rows, positions, agents, steps)
    velocity = np.diff(positions, axis=1) / DT
    gap = np.full((agents, 1, 2), np.nan)
    after, before = np.concatenate([velocity, gap], axis=1), np.concatenate([gap, velocity], axis=1)
    slope = np.where(np.isnan(before), after, (after + before) / 2)
    slope = np.where(np.isnan(after), before, slope)
    step, t = _locate_steps(recording, times)
    ends, slopes = ((table[:, step], table[:, step + 1]) for table in (positions, slope))
    position, velocity = _interpolate_cubic(ends, slopes, t[:, None])
    heading = estimate_heading(velocity, min_speed=MIN_HEADING_SPEED)
    speed = np.hypot(velocity[..., 0], velocity[..., 1])
    return np.concatenate([position, heading[..., None], speed[..., None]], axis=-1)
