"""Simple traffic for the drawn junction: vehicles follow their leader and wait at red."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.geometry import transform_points
from geoaim.synthetic.camera import Traffic
from geoaim.synthetic.cutouts import draw_vehicle
from geoaim.synthetic.objects import PAINTS, SHADOW
from geoaim.synthetic.plan import routes

ACCELERATION, BRAKING, HEADWAY, GAP = 2.6, 2.5, 0.9, 2.0  # m/s2, m/s2, s, m
TOP_SPEED, HARD_BRAKING = 12.5, 4.5  # m/s, m/s2
SUBSTEPS = 3  # of the simulation, for each frame
RESERVE = 0.6  # m, from the front of the first to the stop line
MAIN_RED, SIDE_GREEN = 0.34, 0.52  # when the lights change, as shares of the time


@dataclass(frozen=True)
class _Driver:
    """A vehicle at the start: its way, metres from its front to the stop line, and speed (m/s)."""

    way: str
    before_stop: float
    speed: float
    length: float = 4.4


def drive_junction(
    image_from_plan: Float[Array, "3 3"], times: Float[Array, "T"], generator: np.random.Generator
) -> Traffic:
    """Traffic of one change of the lights, in pixels of the drawn image.

    The side road's queues stand at red for over half of the time, then leave; the main road
    flows, then stops. Vehicles in a lane keep apart by the intelligent driver model
    (Treiber, Hennecke, Helbing 2000).
    """
    red_after, green_after = MAIN_RED * times[-1], SIDE_GREEN * times[-1]
    ways = routes()
    poses, sprites, sizes = [], [], []
    metres_per_pixel = 1 / float(image_from_plan[0, 0])
    for lane in _lanes(generator):
        on_main = lane[0].way.startswith(("west", "east"))
        red = times > red_after if on_main else times < green_after
        fronts = _follow(lane, red, times)
        for driver, front in zip(lane, fronts, strict=True):
            way, stop = ways[driver.way]
            middle = transform_points(image_from_plan, way)
            poses.append(_poses(middle, stop + front - driver.length / 2))
            width = 2.5 if driver.length > 6.5 else 1.8
            paint = PAINTS[generator.integers(len(PAINTS))]
            sprites.append(draw_vehicle(driver.length, width, paint, metres_per_pixel))
            sizes.append([driver.length / metres_per_pixel, width / metres_per_pixel])
    throw = 1.1 * SHADOW / metres_per_pixel
    return Traffic(
        tuple(sprites), np.array(sizes), np.stack(poses, axis=1), (float(throw[0]), float(throw[1]))
    )


def _lanes(generator: np.random.Generator) -> list[list[_Driver]]:
    """The vehicles of each lane, the foremost first."""
    lanes = []
    for arm in ("west", "east"):
        for k in (0, 1):
            front = -58.0 + generator.uniform(0, 12)
            lane: list[_Driver] = []
            while front < 85:
                length = 12.0 if arm == "east" and k == 1 and len(lane) == 2 else _length(generator)
                lane.append(_Driver(f"{arm} {k}", front, generator.uniform(11, 12.5), length))
                front += length + generator.uniform(14, 30)
            lanes.append(lane)
    for arm, waiting in (("south", 2), ("north", 2)):
        front, lane = RESERVE, []
        for rank in range(waiting):
            way = "right" if rank == waiting - 1 else "straight"
            lane.append(_Driver(f"{arm} {way}", front, 0.0, _length(generator)))
            front += lane[-1].length + GAP
        lanes.append(lane)
    return lanes


def _length(generator: np.random.Generator) -> float:
    return float(generator.choice([4.0, 4.3, 4.5, 4.8, 5.4]))


def _follow(lane: list[_Driver], red: Array, times: Float[Array, "T"]) -> Float[Array, "N T"]:
    """Metres of each front past the stop line over time."""
    front = -np.array([driver.before_stop for driver in lane])
    speed = np.array([driver.speed for driver in lane])
    lengths = np.array([driver.length for driver in lane])
    history = np.empty((len(lane), len(times)))
    interval = (times[1] - times[0]) / SUBSTEPS
    for step in range(len(times) * SUBSTEPS):
        if step % SUBSTEPS == 0:
            history[:, step // SUBSTEPS] = front
        gap = np.concatenate([[np.inf], front[:-1] - lengths[:-1] - front[1:]])
        leader = np.concatenate([[0.0], speed[:-1]])
        can_stop = (front < 0) & (-front > speed**2 / (2 * HARD_BRAKING))
        held = red[step // SUBSTEPS] & can_stop & (-front < gap)
        gap, leader = np.where(held, GAP - RESERVE - front, gap), np.where(held, 0.0, leader)
        approach = speed * (speed - leader) / (2 * np.sqrt(ACCELERATION * BRAKING))
        wanted = GAP + (speed * HEADWAY + approach).clip(0)
        change = ACCELERATION * (1 - (speed / TOP_SPEED) ** 4 - (wanted / gap.clip(0.1)) ** 2)
        moved = (speed + change.clip(-7) * interval).clip(0)
        front, speed = front + 0.5 * (speed + moved) * interval, moved
    return history


def _poses(way: Float[Array, "L 2"], along: Float[Array, "T"]) -> Float[Array, "T 3"]:
    """Poses at metres along a way of pixels, with its direction as heading."""
    steps = 0.25 * np.arange(len(way))
    points = [
        np.stack([np.interp(along + ahead, steps, way[:, k]) for k in (0, 1)])
        for ahead in (-1.2, 0, 1.2)
    ]
    right, down = points[2] - points[0]
    poses = np.stack([*points[1], np.arctan2(-down, right)], axis=1)
    poses[(along < 2) | (along > steps[-1] - 2)] = np.nan
    return poses
