"""Conflicts: where the routes of two agents share ground, found once for all steps.

Two agents overlap, or nearly, at a set of pairs of distances along their two routes. Each connected
part of the set is a conflict: a rectangle, and for routes with the same or the opposite direction a
band along its diagonal, since there one agent follows or meets the other.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage
from torch import Tensor

from geoaim.simulation.kinematics import WHEELBASE_PER_LENGTH
from geoaim.simulation.routes import ROUTE_SPACING_M, Routes

STRIDE_M = 1.0  # distance between the places of a route that are compared with other routes
# how far `Conflicts.reach` exceeds half of the sum of both lengths, on average
REACH_SLACK_M = 1.5 * STRIDE_M
SIDE_MARGIN_M = 0.15  # added on both sides of each agent
# cosine of the mean angle between routes that have the same or opposite directions
MIN_PARALLEL_COSINE = 0.5


@dataclass(frozen=True, eq=False)
class Conflicts:
    """Z conflicts between two agents, in E = 2 Z entries: the first agents, then the second ones.

    Distances are those of the agent's centre along its route, metres.
    """

    agent: Int[Tensor, "E"]  # row of the agent, counted over all scenes: scene * A + agent
    start: Float[Tensor, "E"]  # distance at which the conflict begins
    end: Float[Tensor, "E"]  # distance at which it ends
    follows: Bool[Tensor, "E"]  # whether the routes have the same direction
    faces: Bool[Tensor, "E"]  # whether they have opposite directions
    # on routes with the same or opposite directions, the other agent at distance s along its own
    # route is at distance offset + slope * s along this agent's route
    offset: Float[Tensor, "E"]
    slope: Float[Tensor, "E"]
    reach: Float[Tensor, "E"]  # both agents touch when they are nearer along that route


def find_conflicts(
    routes: Routes, sizes: Float[Tensor, "B A 2"], controlled: Bool[Tensor, "B A"]
) -> Conflicts:
    """Find the conflicts of all pairs of agents (sizes in m), at least one of which is controlled.

    Routes reach up to their recorded ends.
    """
    found = [np.empty((0, 10))]
    count = routes.points.shape[1]
    given = routes.points, routes.lengths, sizes
    for scene, values in enumerate(zip(*given, strict=True)):
        points, lengths, boxes = (value.detach().double().cpu().numpy() for value in values)
        places = [_place_boxes(points[k], lengths[k], boxes[k]) for k in range(len(boxes))]
        reacts = controlled[scene].cpu().numpy()
        for row in range(count):
            for column in range(row + 1, count):
                if reacts[row] or reacts[column]:
                    parts = _find_parts(places[row], places[column])
                    pair = np.array([[scene * count + row, scene * count + column]])
                    found.append(np.hstack([np.repeat(pair, len(parts), 0), parts]))
    table = torch.tensor(np.concatenate(found)).to(routes.points)
    first, second, start, other_start, end, other_end, direction, offset, slope, reach = table.T
    return Conflicts(
        torch.cat([first, second]).long(),
        torch.cat([start, other_start]),
        torch.cat([end, other_end]),
        torch.cat([direction, direction]) > 0,
        torch.cat([direction, direction]) < 0,
        torch.cat([offset, -offset / slope]),
        torch.cat([slope, 1 / slope]),
        torch.cat([reach, reach / slope.abs()]),
    )


@dataclass(frozen=True, eq=False)
class _Places:
    """The box of an agent at places along its route, `STRIDE_M` apart."""

    centres: Float[Array, "K 2"]
    forward: Float[Array, "K 2"]  # unit vectors
    half: Float[Array, "2"]  # half of the length and half of the width, with margins


def _place_boxes(points: Float[Array, "P 2"], length: float, size: Float[Array, "2"]) -> _Places:
    """Place a box along a route; it heads along the chord from one wheelbase behind its centre."""
    arcs = np.arange(len(points)) * ROUTE_SPACING_M
    s = np.arange(int(np.ceil(length / STRIDE_M)) + 1) * STRIDE_M
    behind = np.maximum(s - WHEELBASE_PER_LENGTH * size[0], 0.0)
    ahead = np.maximum(s, behind + 0.5 * STRIDE_M)
    centres, tails, heads = (
        np.column_stack([np.interp(at, arcs, axis) for axis in points.T])
        for at in (s, behind, ahead)
    )
    forward = heads - tails
    forward /= np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-9)
    return _Places(centres, forward, size / 2 + [STRIDE_M / 2, SIDE_MARGIN_M])


def _find_parts(first: _Places, second: _Places) -> Float[Array, "n 8"]:
    """Find the conflicts of two routes."""
    reach = np.linalg.norm(first.half) + np.linalg.norm(second.half)
    low = np.maximum(first.centres.min(axis=0), second.centres.min(axis=0)) - reach
    high = np.minimum(first.centres.max(axis=0), second.centres.max(axis=0)) + reach
    if (low > high).any():
        return np.empty((0, 8))
    offset = first.centres[:, None] - second.centres
    row, column = np.nonzero((offset**2).sum(axis=-1) < reach**2)
    touches = _find_overlaps(first, second, row, column)
    row, column = row[touches], column[touches]
    if not len(row):
        return np.empty((0, 8))
    touching = np.zeros((len(first.centres), len(second.centres)), bool)
    touching[row, column] = True
    labels, count = ndimage.label(touching, np.ones((3, 3)))
    label = labels[row, column]
    parts = [
        _describe_part(first, second, row[label == k], column[label == k])
        for k in range(1, count + 1)
    ]
    return np.array(parts)


def _find_overlaps(
    first: _Places, second: _Places, row: Int[Array, "n"], column: Int[Array, "n"]
) -> Bool[Array, "n"]:
    """Mark pairs of boxes that overlap, by the theorem of separating axes."""
    offset = second.centres[column] - first.centres[row]
    u, v = first.forward[row], second.forward[column]
    cosine, sine = np.abs((u * v).sum(axis=1)), np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    overlaps = np.ones(len(row), bool)
    for axis, own, other in ((u, first.half, second.half), (v, second.half, first.half)):
        along = np.abs((offset * axis).sum(axis=1))
        aside = np.abs(offset[:, 0] * axis[:, 1] - offset[:, 1] * axis[:, 0])
        overlaps &= along < own[0] + other[0] * cosine + other[1] * sine
        overlaps &= aside < own[1] + other[0] * sine + other[1] * cosine
    return overlaps


def _describe_part(
    first: _Places, second: _Places, row: Int[Array, "n"], column: Int[Array, "n"]
) -> list[float]:
    """Describe a connected part of the pairs of places at which two boxes touch."""
    half = STRIDE_M / 2  # distance to the middle between two neighbouring places
    x, y = row * STRIDE_M, column * STRIDE_M
    bounds = [x.min() - half, y.min() - half, x.max() + half, y.max() + half]
    cosine = float((first.forward[row] * second.forward[column]).sum(axis=1).mean())
    if abs(cosine) < MIN_PARALLEL_COSINE or np.ptp(y) == 0 or np.ptp(x) == 0:
        return [*bounds, 0.0, 0.0, 1.0, 0.0]
    slope = float(np.sign(cosine) * x.std() / y.std())  # the axis of the band
    apart = x - slope * y
    offset = float(apart.max() + apart.min()) / 2
    reach = float(np.ptp(apart)) / 2 + half * (1 + abs(slope))
    return [*bounds, float(np.sign(cosine)), offset, slope, reach]
