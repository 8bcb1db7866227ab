"""Traffic lights of datasets that state a stop point for each lane, and no stop line."""

import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import warn
from geoaim.base.limits import MAX_POSITION_M
from geoaim.base.world import World
from geoaim.tracks.lights import UNKNOWN, Lights

LANE_WIDTH_M = 3.5  # width of a lane where a file gives its middle line only


@dataclass(frozen=True, eq=False)
class LaneSignals:
    """The signals that are seen at T steps."""

    times: Float[Array, "T"]  # seconds, increasing
    # a row for each signal and step: step, lane (text), state (as in `geoaim.tracks.lights`), and
    # the stop point x, y (metres in the file's plane)
    table: pd.DataFrame


def make_lights(
    path: str | os.PathLike[str],
    signals: LaneSignals,
    middles: Mapping[str, Float[Array, "n 2"]],
    world: World,
) -> Lights | None:
    """Make lights that stand across the middles of their lanes, `LANE_WIDTH_M` wide.

    Args:
        path: the file that warnings name.
        signals: the signals seen at each step; a light that is not seen at a step is unknown.
        middles: points of the middle of each lane, metres in the file's plane.
        world: the plane of the lights, which is the file's but for the origin.

    Returns:
        The lights, named by their lanes; None where no lane has any.

    Raises:
        ValueError: there are more steps than times, or a light lies off the Earth.
    """
    table, times = signals.table, signals.times
    if table["step"].max() >= len(times):
        raise ValueError(f"lights have more steps than the {len(times)} times")
    known = table[table["lane"].isin(list(middles))]
    if missing := table["lane"].nunique() - known["lane"].nunique():
        warn(f"{path}: {missing} signals are left out, whose lanes the map does not have")
    if not len(known):
        return None
    lanes = list(dict.fromkeys(known["lane"]))
    states = np.full((len(times), len(lanes)), UNKNOWN, np.int8)
    states[known["step"], known["lane"].map(lanes.index)] = known["state"]
    points = known.drop_duplicates("lane")[["x", "y"]].to_numpy(np.float64)
    lines = [_cross_lane(point, middles[lane]) for point, lane in zip(points, lanes, strict=True)]
    placed = np.array(lines) - world.origin
    if not (np.abs(placed) <= MAX_POSITION_M).all():
        raise ValueError(f"a light lies {np.abs(placed).max():g} m from the tracks")
    return Lights(tuple(lanes), placed, times, states, world)


def _cross_lane(point: Float[Array, "2"], middle: Float[Array, "n 2"]) -> Float[Array, "2 2"]:
    """Make the line across a lane at a point: from its right to its left."""
    nearest = int(np.linalg.norm(middle - point, axis=1).argmin())
    start = min(nearest, len(middle) - 2)
    along = middle[start + 1] - middle[start]
    left = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-9)
    return np.stack([point - LANE_WIDTH_M / 2 * left, point + LANE_WIDTH_M / 2 * left])
