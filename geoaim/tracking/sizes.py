"""Sizes of agents from many boxes, and types from the detector or by size."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.tracks.agent_types import OTHER_SIZE, TYPICAL_SIZES, find_group

SIZE_SIGMA = 0.25  # of the logarithms of sizes about those that are typical of their type
EFFECTIVE_BOXES = 30.0  # independent boxes that a track counts as at most: a detector's errors last
MIN_SIZE_M = 0.2
MAX_SMALL_RESOLUTION = 0.12  # metres per pixel up to which vehicles are searched with people
UNKNOWN_TYPE = "unknown"  # of agents without a type and without extents
ITERATIONS = 3
TURNS = np.radians(np.arange(0.0, 180.0, 1.0))  # headings that are compared with a box's extents
MAX_ERRORS = 2.5  # standard deviations beyond which a box counts less (Huber 1964)


# spectral density of the acceleration by group, m²/s³; chosen on validation videos
ACCELERATION_NOISE = {"vehicle": 1.0, "pedestrian": 0.15, "cyclist": 0.5, "other": 0.5}


@dataclass(frozen=True, eq=False)
class AgentTraits:
    """What is the same for an agent at all times; N agents."""

    types: tuple[str, ...]
    sizes: Float[Array, "N 2"]  # length and width, m

    @property
    def acceleration_noise(self) -> Float[Array, "N"]:
        """Spectral densities of the accelerations, m²/s³."""
        return np.array([ACCELERATION_NOISE[find_group(kind)] for kind in self.types])


def get_typical_size(kind: str) -> tuple[float, float]:
    """Get the typical length and width of an agent type, m."""
    return TYPICAL_SIZES.get(kind, OTHER_SIZE)


def predict_extents(size: Float[Array, "2"], turn: Float[Array, "*m"]) -> Float[Array, "*m 2"]:
    """Predict the sides (m) of upright boxes about an agent that is turned (rad) in them.

    >>> predict_extents(np.array([4.0, 2.0]), np.array([0.0, np.pi / 2])).round(6)
    array([[4., 2.],
           [2., 4.]])
    """
    cosine, sine = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    return np.stack([cosine, sine, sine, cosine], axis=-1).reshape(*turn.shape, 2, 2) @ size


def estimate_size(
    extent: Float[Array, "m 2"], turn: Float[Array, "m"], sigma: float, kind: str
) -> Float[Array, "2"]:
    """Estimate length and width (m) from the extents of many boxes, by robust least squares.

    Upright boxes about a turned agent (rad) are larger than it (`predict_extents`); at 45° they
    only tell the sum of length and width, which the typical size of the type then divides, as
    it does where boxes do not tell. Sigma is that of a side.
    """
    prior = np.array(get_typical_size(kind))
    cosine, sine = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    rows = np.concatenate([np.column_stack([cosine, sine]), np.column_stack([sine, cosine])])
    values = np.concatenate([extent[:, 0], extent[:, 1]])
    share = min(1.0, EFFECTIVE_BOXES / max(len(extent), 1))
    size = prior
    for _ in range(ITERATIONS):
        misfit = np.abs(values - rows @ size) / max(sigma, 1e-3)
        weight = np.minimum(1, MAX_ERRORS / np.maximum(misfit, 1e-9))
        weighted = rows * (share * weight / max(sigma, 1e-3) ** 2)[:, None]
        known = (SIZE_SIGMA * prior) ** -2.0
        size = np.linalg.solve(
            weighted.T @ rows + np.diag(known), weighted.T @ values + known * prior
        )
    return np.maximum(size, MIN_SIZE_M)


def vote_type(
    types: Sequence[str],
    extent: Float[Array, "m 2"],
    turn: Float[Array, "m"] | None = None,
    *,
    resolution: float = 0.0,
) -> str:
    """Choose the type that a detector gave most often; without any, the one that fits its boxes.

    `turn` is that of the agent in its boxes, rad; None: any. Beyond `MAX_SMALL_RESOLUTION` metres
    per pixel only vehicles are several pixels wide, and what is smaller is a part of one.
    """
    named = Counter(kind for kind in types if kind)
    if named:
        return named.most_common(1)[0][0]
    usable = extent.min(axis=1) > 0
    if not usable.any():
        return UNKNOWN_TYPE
    known = np.log(np.maximum(extent[usable], MIN_SIZE_M))
    if turn is None:
        known, turns = np.median(known, axis=0)[None, None], TURNS[:, None]
    else:
        turns = turn[usable][None]
    kinds = {"pedestrian": OTHER_SIZE, **TYPICAL_SIZES}
    del kinds["motorcycle"]  # as large as a bicycle with its rider
    if resolution > MAX_SMALL_RESOLUTION:
        kinds = {kind: size for kind, size in kinds.items() if find_group(kind) == "vehicle"}

    def measure_misfit(kind: str) -> float:
        misfit = (np.log(predict_extents(np.array(kinds[kind]), turns)) - known) ** 2
        return float(misfit.mean(axis=(1, 2)).min())

    return min(kinds, key=measure_misfit)
