"""A second, plain generator: vehicles on lanes that cross, turn and queue, without a simulator."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.tracking.cases import FRAME_RATE, DetectorErrors, TrackingCase, make_case_of
from geoaim.base.world import World
from geoaim.tracks.tracks import Tracks

EXTENT = (176.0, 99.0)  # of the frame, m
RESOLUTION = 0.0917
LANE_WIDTH = 3.3
SIZES = {"car": (4.5, 1.8), "van": (5.6, 2.0), "truck": (9.0, 2.5), "bus": (12.0, 2.55)}
SHARES = (0.75, 0.12, 0.08, 0.05)
STEP_M = 0.25  # between points of a lane
REAR_AXLE = 0.3  # of the length, behind the middle


def make_lanes_case(
    seed: int, *, seconds: float = 12.0, errors: DetectorErrors, parked: int = 14
) -> TrackingCase:
    """Make vehicles on lanes, parked ones beside them, and their boxes.

    Args:
        seed: of everything in it.
        seconds: of traffic.
        errors: of the detector.
        parked: number of vehicles that stand all the time.

    Returns:
        The case.
    """
    generator = np.random.default_rng(seed)
    times = np.arange(round(seconds * FRAME_RATE)) / FRAME_RATE
    states, types, sizes = [], [], []
    for lane in _make_lanes(generator):
        for path, kind, size in _drive(lane, times, generator):
            states.append(path)
            types.append(kind)
            sizes.append(size)
    for number in range(parked):
        x, y = 6.0 + 11.5 * number, (3.0, EXTENT[1] - 3.0)[number % 2]
        heading = float(generator.choice([0.0, np.pi, 0.5 * np.pi, 0.6]))
        states.append(np.tile([x, y, heading, 0.0], (len(times), 1)))
        types.append("car")
        sizes.append((4.5 * generator.uniform(0.9, 1.1), 1.8 * generator.uniform(0.95, 1.05)))
    array = np.stack(states)
    present = np.isfinite(array[..., 0])
    ids = tuple(map(str, range(len(types))))
    truth = Tracks(times, array, present, np.array(sizes), tuple(types), ids, World(None))
    matrix = np.array([[RESOLUTION, 0, 0], [0, -RESOLUTION, EXTENT[1]], [0, 0, 1]])
    world_from_frame = np.tile(matrix, (len(times), 1, 1))
    world_from_frame[:, 0, 2] += np.sin(times)
    return make_case_of(f"lanes {seed}", truth, world_from_frame, (1080, 1920), errors, generator)


def _make_lanes(generator: np.random.Generator) -> list[Float[Array, "n 2"]]:
    """Lanes of two crossing roads, two each way, and those that turn left and right at them."""
    width, height = EXTENT
    x0, y0 = width * generator.uniform(0.4, 0.6), height / 2
    half, reach = LANE_WIDTH / 2, 15.0
    lanes = []
    for offset in (half, 3 * half):
        lanes += [_join([[-20, y0 - offset], [width + 20, y0 - offset]])]
        lanes += [_join([[width + 20, y0 + offset], [-20, y0 + offset]])]
        lanes += [_join([[x0 + offset, -20], [x0 + offset, height + 20]])]
        lanes += [_join([[x0 - offset, height + 20], [x0 - offset, -20]])]
    start, end = [-20, y0 - half], [x0 + half, height + 20]
    lanes += [_join([start, [x0 - reach, y0 - half], [x0 + half, y0 + reach], end])]
    start, end = [width + 20, y0 + 3 * half], [x0 + 3 * half, height + 20]
    lanes += [_join([start, [x0 + reach, y0 + 3 * half], [x0 + 3 * half, y0 + reach], end])]
    return lanes


def _join(points: list[list[float]]) -> Float[Array, "n 2"]:
    """Join two points by a line, or four by lines and an arc between them, evenly spaced."""
    corners = np.array(points, float)
    if len(corners) == 4:
        bend = np.linspace(0, 1, 80)[:, None]
        before, after = corners[1] - corners[0], corners[3] - corners[2]
        before, after = before / np.hypot(*before), after / np.hypot(*after)
        crossing = corners[1] + before * abs((corners[2] - corners[1]) @ before)
        arc = (1 - bend) ** 2 * corners[1] + 2 * bend * (1 - bend) * crossing
        corners = np.concatenate([corners[:1], arc + bend**2 * corners[2], corners[3:]])
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    grid = np.arange(0, along[-1], STEP_M)
    return np.column_stack([np.interp(grid, along, corners[:, axis]) for axis in (0, 1)])


def _drive(
    lane: Float[Array, "n 2"], times: Float[Array, "T"], generator: np.random.Generator
) -> list[tuple[Float[Array, "T 4"], str, tuple[float, float]]]:
    """Drive a platoon along a lane, which slows, stops and starts as one, by its own profile."""
    dt = 1 / FRAME_RATE
    speed = generator.uniform(7, 14) * np.ones(len(times))
    if generator.uniform() < 0.5:  # stops at a time, and starts again
        stop, wait = generator.uniform(2, 6), generator.uniform(1, 5)
        speed *= np.clip((stop - times) / 4, 0, 1) + np.clip((times - stop - wait) / 4, 0, 1)
    travelled = np.cumsum(speed) * dt
    length, found, behind = STEP_M * (len(lane) - 1), [], generator.uniform(0, 15)
    while behind < length + travelled[-1]:
        kind = str(generator.choice(list(SIZES), p=SHARES))
        size = SIZES[kind][0] * generator.uniform(0.9, 1.1), SIZES[kind][1]
        rear = length - behind + travelled
        rear = rear + 0.5 * np.sin(times / 2 + behind)
        points = np.column_stack(
            [np.interp(rear, STEP_M * np.arange(len(lane)), lane[:, axis]) for axis in (0, 1)]
        )
        ahead = np.column_stack(
            [np.interp(rear + 0.3, STEP_M * np.arange(len(lane)), lane[:, axis]) for axis in (0, 1)]
        )
        heading = np.arctan2(*(ahead - points).T[::-1])
        facing = np.column_stack([np.cos(heading), np.sin(heading)])
        own = np.gradient(rear, dt)
        states = np.column_stack([points + REAR_AXLE * size[0] * facing, heading, own])
        states[(rear < 0) | (rear > length - 0.5)] = np.nan
        if np.isfinite(states).any():
            found.append((states, kind, size))
        behind += size[0] + generator.uniform(5, 60)
    return found
