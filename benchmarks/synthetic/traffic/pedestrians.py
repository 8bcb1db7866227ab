"""The state of all pedestrians and cyclists, what is ahead of them, and one time step.

They move by the social force model (Helbing and Molnár 1995, Phys. Rev. E 51): towards a point
ahead on their path, away from each other and from the edges of the pavement.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from benchmarks.synthetic.exact import round_reproducibly
from benchmarks.synthetic.roads.curves import POINT_SPACING_M
from benchmarks.synthetic.roads.plan import Roads

CELL_M = 0.25  # side of a cell of the pavement map
MAP_MARGIN_M = 12.0  # margin around the drawn extent
MIN_SLOPE = 1e-6  # smallest slope of the distance, so that its direction is defined
RELAXATION_S = 0.5  # time to reach the desired velocity
PEDESTRIAN_FORCE, PEDESTRIAN_RANGE_M = 2.2, 0.28  # m/s2, between two pedestrians
REAR_WEIGHT = 0.3  # weight of forces from behind, relative to those from the front
EDGE_FORCE, EDGE_RANGE_M = 1.6, 0.22  # m/s2, from the edge of the pavement
MAX_EDGE_FORCE = 4.0  # m/s2
EDGE_MARGIN_M = 0.15  # no force moves a pedestrian nearer to the edge of the pavement
NOISE, MAX_NOISE_SPEED = 0.45, 1.6  # m/s2 of random force for each m/s of desired speed; m/s
MAX_SPEED_FACTOR = 1.3  # largest speed as a multiple of the desired speed
TARGET_M, TARGET_S = 1.6, 0.5  # distance and time on the path to the point that they head for
KERB_DISTANCE_M = 0.7  # pedestrians stop at this distance from the kerb
MIN_STEPPING_SPEED = 0.3  # m/s, above which vehicles expect that a pedestrian steps on a crossing
MIN_CROSSING_SPEED = 0.8  # m/s that vehicles expect on a crossing


@dataclass(frozen=True)
class Pedestrians:
    """The pedestrians and cyclists at one time (n of them)."""

    trip: Int[Array, "n"]  # index of the pedestrian's trip
    position: Float[Array, "n 2"]  # metres in the plan of the place
    velocity: Float[Array, "n 2"]  # m/s in x and y
    path: Float[Array, "n K 2"]  # equally spaced points; shorter paths repeat their last one
    crossing: Int[Array, "n K"]  # index of the crossing at each point of the path; -1: none
    last: Int[Array, "n"]  # index of the path's last point
    s: Float[Array, "n"]  # metres of the path walked so far
    lateral_offset: Float[Array, "n"]  # metres to the left of the path where they prefer to walk
    desired_speed: Float[Array, "n"]  # m/s
    radius: Float[Array, "n"]  # radius of the body, metres


@dataclass(frozen=True)
class PavementMap:
    """Distances to the edge of the pavement on a grid over the plan, whose rows run upwards."""

    # metres to the nearest edge, 0 off the pavement; and the unit vector away from that edge
    table: Float[Array, "H W 3"]
    corner: Float[Array, "2"]  # plan coordinates of the first cell's outer corner


@dataclass(frozen=True)
class CrossingTable:
    """The crossings of a place (C of them)."""

    first: Float[Array, "C 2"]  # their first ends, plan metres
    direction: Float[Array, "C 2"]  # unit vectors to the other end
    signal: Int[Array, "C"]  # index of the pedestrians' traffic light; -1: none
    marked: Bool[Array, "C"]  # whether vehicles stop for pedestrians who want to cross
    priority: Bool[Array, "C"]  # whether pedestrians never wait: a pavement that a driveway crosses


@dataclass(frozen=True)
class CrossingPedestrians:
    """Pedestrians on a crossing or stepping on it, as vehicles see them (m of them)."""

    crossing: Int[Array, "m"]  # its index
    offset: Float[Array, "m"]  # metres from its first end
    speed: Float[Array, "m"]  # m/s along it, positive away from the first end; not 0
    radius: Float[Array, "m"]  # radius of the body along the crossing, metres


@dataclass(frozen=True)
class Outlook:
    """What is ahead of n pedestrians, of whom m are on a crossing or near one."""

    on_crossing: Bool[Array, "n"]  # whether they are on a crossing
    target: Float[Array, "n 2"]  # the point of the path that they head for
    direction: Float[Array, "n 2"]  # direction of the path there
    near: Int[Array, "m"]  # indices of those on a crossing or near one
    crossing: Int[Array, "m"]  # its index
    offset: Float[Array, "m"]  # metres from its first end
    sign: Float[Array, "m"]  # 1 for those who walk away from the first end, else -1
    visible: CrossingPedestrians  # the ones of the m pedestrians on crossings whom vehicles notice


@dataclass(frozen=True)
class Reaction:
    """How pedestrians react to vehicles and lights (n pedestrians)."""

    waits: Bool[Array, "n"]  # whether they stand still
    # metres to the left of the path by which they walk around a vehicle; 0: none
    detour: Float[Array, "n"]


def make_pavement_map(roads: Roads) -> PavementMap:
    """Rasterise the pavements, footpaths and driveway of a place."""
    paving = roads.paving
    walkable = shapely.union_all([paving.pavement, paving.driveway, roads.footpaths.surface])
    left, bottom, right, top = roads.extent.buffer(MAP_MARGIN_M).bounds
    corner = np.array([left, bottom])
    mask = np.zeros((round((top - bottom) / CELL_M), round((right - left) / CELL_M)), np.uint8)
    for part in shapely.get_parts(walkable):
        rings = [np.array(ring.coords) for ring in (part.exterior, *part.interiors)]
        cells = [np.rint((ring - corner) / CELL_M - 0.5).astype(np.int32) for ring in rings]
        cv2.fillPoly(mask, cells, 1)
    distance = CELL_M * cv2.distanceTransform(mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    distance = np.round(distance.astype(np.float64), 6)
    smooth = np.round(cv2.GaussianBlur(distance, (0, 0), 1.0), 4)
    slope_y, slope_x = np.gradient(smooth)
    slope = np.sqrt(slope_y**2 + slope_x**2).clip(MIN_SLOPE)
    table = np.stack([distance, slope_x / slope, slope_y / slope], axis=-1)
    return PavementMap(np.round(table, 4), corner)


def sample_pavement(
    pavement: PavementMap, positions: Float[Array, "n 2"]
) -> tuple[Float[Array, "n"], Float[Array, "n 2"]]:
    """Look up metres to the nearest edge at positions (plan metres), and the unit vector from it.

    The distance is 0 off the pavement.
    """
    cells = ((positions - pavement.corner) / CELL_M).astype(np.int64)
    height, width = pavement.table.shape[:2]
    column = np.minimum(np.maximum(cells[:, 0], 0), width - 1)
    row = np.minimum(np.maximum(cells[:, 1], 0), height - 1)
    values = pavement.table[row, column]
    return values[:, 0], values[:, 1:]


def look_ahead(pedestrians: Pedestrians, crossings: CrossingTable) -> Outlook:
    """Look up where each pedestrian's path leads next, and over which crossing."""
    last, speed = pedestrians.last, pedestrians.desired_speed
    rows, here = np.arange(len(last)), np.minimum(_count_points(pedestrians.s), last)
    ahead = np.minimum(here + _count_points(np.maximum(TARGET_M, TARGET_S * speed)), last)
    kerb = np.minimum(here + _count_points(KERB_DISTANCE_M + RELAXATION_S * speed), last)
    target = pedestrians.path[rows, ahead]
    direction = target - pedestrians.path[rows, np.maximum(ahead - 2, 0)]
    direction = direction / np.maximum(np.sqrt(dot(direction, direction)), 1e-6)[:, None]
    current = pedestrians.crossing[rows, here]
    crossing = np.where(current >= 0, current, pedestrians.crossing[rows, kerb])
    near = np.flatnonzero(crossing >= 0)
    crossing = crossing[near]
    along = crossings.direction[crossing]
    offset = dot(pedestrians.position[near] - crossings.first[crossing], along)
    sign = np.where(dot(direction[near], along) < 0, -1.0, 1.0)
    velocity = pedestrians.velocity[near]
    steps = (current[near] >= 0) | (dot(velocity, velocity) > MIN_STEPPING_SPEED**2)
    crossing_speed = sign * np.maximum(np.abs(dot(velocity, along)), MIN_CROSSING_SPEED)
    radius = np.where(pedestrians.radius[near] > 0.3, 0.9, 0.3)  # cyclists, pedestrians
    values = (crossing, offset, crossing_speed, radius)
    visible = CrossingPedestrians(*(value[steps] for value in values))
    return Outlook(current >= 0, target, direction, near, crossing, offset, sign, visible)


def step_pedestrians(
    pedestrians: Pedestrians,
    outlook: Outlook,
    reaction: Reaction,
    pavement: PavementMap,
    noise: Float[Array, "n 2"],
    dt: float,
) -> Pedestrians:
    """Move all pedestrians by one time step.

    Args:
        pedestrians: all pedestrians and cyclists.
        outlook: outlook of these pedestrians.
        reaction: reaction to vehicles and lights.
        pavement: the pavement, on which they may walk.
        noise: standard normal numbers, for a random force.
        dt: seconds.

    Returns:
        The pedestrians after the step.
    """
    if len(pedestrians.trip) == 0:
        return pedestrians
    force = _drive_to_target(pedestrians, outlook, reaction) + _repel(pedestrians)
    noise_speed = np.minimum(pedestrians.desired_speed, MAX_NOISE_SPEED)
    force += (NOISE * ~reaction.waits * noise_speed)[:, None] * noise
    distance, inwards = sample_pavement(pavement, pedestrians.position)
    edge = EDGE_FORCE * np.exp((pedestrians.radius - distance) / EDGE_RANGE_M)
    edge = np.where(outlook.on_crossing, 0.0, np.minimum(edge, MAX_EDGE_FORCE))
    force += edge[:, None] * inwards
    velocity = pedestrians.velocity + force * dt
    speed = np.maximum(np.sqrt(dot(velocity, velocity)), 1e-6)
    slowdown = np.minimum(1.0, MAX_SPEED_FACTOR * pedestrians.desired_speed / speed)
    velocity = round_reproducibly(velocity * slowdown[:, None])
    position = pedestrians.position + velocity * dt
    distance, inwards = sample_pavement(pavement, position)
    outside = np.where(outlook.on_crossing, 0.0, np.maximum(EDGE_MARGIN_M - distance, 0))
    position = round_reproducibly(position + outside[:, None] * inwards)
    progress = np.maximum(dot(position - pedestrians.position, outlook.direction), 0)
    s = round_reproducibly(pedestrians.s + progress)
    return replace(pedestrians, position=position, velocity=velocity, s=s)


def dot(a: Float[Array, "n 2"], b: Float[Array, "n 2"]) -> Float[Array, "n"]:
    """Compute the dot product of each pair of rows."""
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])


def _count_points(distance: Float[Array, "n"]) -> Int[Array, "n"]:
    return (distance / POINT_SPACING_M).astype(np.int64)


def _drive_to_target(
    pedestrians: Pedestrians, outlook: Outlook, reaction: Reaction
) -> Float[Array, "n 2"]:
    """The driving force towards the target; those who wait before a vehicle sidestep."""
    direction, has_detour = outlook.direction, reaction.detour != 0
    left = np.column_stack([-direction[:, 1], direction[:, 0]])
    offset = np.where(has_detour, reaction.detour, pedestrians.lateral_offset)
    ahead = dot(outlook.target - pedestrians.position, direction)
    target = outlook.target - np.where(reaction.waits & has_detour, ahead, 0.0)[:, None] * direction
    to_target = target + offset[:, None] * left - pedestrians.position
    speed = np.where(reaction.waits & ~has_detour, 0.0, pedestrians.desired_speed)
    speed = speed / np.maximum(np.sqrt(dot(to_target, to_target)), 1e-6)
    return (speed[:, None] * to_target - pedestrians.velocity) / RELAXATION_S


def _repel(pedestrians: Pedestrians) -> Float[Array, "n 2"]:
    """The repulsive forces between pedestrians, strongest from those in front."""
    x, y = pedestrians.position.T
    dx, dy = x[:, None] - x, y[:, None] - y
    distance = np.maximum(np.sqrt(dx * dx + dy * dy), 0.05) + np.diag(np.full(len(x), 1e3))
    overlap = np.minimum(pedestrians.radius[:, None] + pedestrians.radius - distance, 0.3)
    strength = PEDESTRIAN_FORCE * np.exp(overlap / PEDESTRIAN_RANGE_M) / distance
    u, v = pedestrians.velocity.T
    speed = np.maximum(np.sqrt(u * u + v * v), 0.1)
    cosine = -(dx * u[:, None] + dy * v[:, None]) / (distance * speed[:, None])
    strength *= REAR_WEIGHT + (1 - REAR_WEIGHT) * 0.5 * (1 + cosine)
    return np.column_stack([(strength * dx).sum(axis=1), (strength * dy).sum(axis=1)])
