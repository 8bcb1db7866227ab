"""How good predictions are: nearness of the best sample, spread, and what goes wrong in them.

All numbers are kept for each segment, so that intervals come from drawing segments anew.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from torch import Tensor

from geoaim.lights import UNKNOWN
from geoaim.prediction.segments import VEHICLE, Segments
from geoaim.simulation.episodes import NO_RULES, Rules
from geoaim.simulation.infractions import collisions, offroad_distance, ran_red

DRAWS = 1000  # of segments, for an interval
LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class Measure:
    """A quantity: its sum in each segment, and over how many agents, samples and steps it is."""

    sums: Float[Array, "S"]
    counts: Float[Array, "S"]

    @property
    def mean(self) -> float:
        """Of everything counted; NaN where nothing was."""
        total = self.counts.sum()
        return float(self.sums.sum() / total) if total else float("nan")


def measure(
    futures: Float[Tensor, "S K T A 4"],
    segments: Segments,
    observed: int,
    rules: Rules = NO_RULES,
) -> dict[str, Measure]:
    """All measures of some predictions, by name.

    `minADE` and `minFDE` take the best sample of each agent; `joint minADE` and `joint minFDE` the
    sample that is best for all of a segment together, as the paper does. `MFD` is the largest
    distance between two samples' ends. Rates are of agents, samples and predicted steps; those
    that nothing could break are left out.

    Args:
        futures: of all agents, observed steps included.
        segments: what happened; who is controlled is judged.
        observed: steps that were given.
        rules: what a map says about where vehicles may be.
    """
    off = displacements(futures, segments, observed)
    who, agents = segments.controlled, segments.controlled.sum(dim=1)
    ends = _final(futures, segments)
    found = {}
    for name, apart in (("ADE", off), ("FDE", ends)):
        best = torch.where(who, apart.amin(dim=1), 0.0)
        found[f"min{name}"] = _measure(best.sum(dim=1), agents)
        together = torch.where(who[:, None], apart, 0.0).sum(dim=2).amin(dim=1)
        found[f"joint min{name}"] = _measure(together, agents)
    found["MFD"] = _measure(torch.where(who, _spread(futures), 0.0).sum(dim=1), agents)
    return found | _rates(futures, segments, observed, rules)


def displacements(
    futures: Float[Tensor, "S K T A 4"], segments: Segments, observed: int
) -> Float[Tensor, "S K A"]:
    """Mean distance from the truth over the predicted steps."""
    apart = futures[:, :, observed:, :, :2] - segments.states[:, None, observed:, :, :2]
    return apart.norm(dim=-1).mean(dim=2)


def interval(
    measure: Measure, other: Measure | None = None, *, seed: int = 0
) -> tuple[float, float]:
    """Within which the mean lies, or the difference from another's on the same segments.

    By the percentiles of the bootstrap over segments (Efron 1979).

    >>> low, high = interval(Measure(np.array([1.0, 2.0, 3.0]), np.ones(3)))
    >>> bool(1 <= low < 2 < high <= 3)
    True
    """
    generator = np.random.default_rng(seed)
    count = len(measure.sums)
    drawn = generator.integers(0, count, (DRAWS, count))
    means = _means(measure, drawn)
    if other is not None:
        means = means - _means(other, drawn)
    low, high = np.nanquantile(means, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)


def merged(parts: list[dict[str, Measure]]) -> dict[str, Measure]:
    """Measures of several sets of segments as of one; one that a set lacks counts nothing there."""
    found = {}
    for name in dict.fromkeys(name for part in parts for name in part):
        rows = [part.get(name) or _nothing(part) for part in parts]
        found[name] = Measure(
            np.concatenate([row.sums for row in rows]),
            np.concatenate([row.counts for row in rows]),
        )
    return found


def pooled(trainings: Sequence[Mapping[str, Measure]]) -> dict[str, Measure]:
    """Measures of several trainings on the same segments as of one, whose segments stay as many.

    Intervals are narrower by what the trainings differ; they do not say by how much they do.
    """
    return {
        name: Measure(
            np.sum([found[name].sums for found in trainings], axis=0),
            np.sum([found[name].counts for found in trainings], axis=0),
        )
        for name in trainings[0]
    }


def _nothing(part: dict[str, Measure]) -> Measure:
    zeros = np.zeros_like(next(iter(part.values())).sums)
    return Measure(zeros, zeros)


def summary(measures: Mapping[str, Measure]) -> dict[str, dict[str, float]]:
    """Means with their intervals, as plain numbers."""
    found = {}
    for name, value in measures.items():
        low, high = interval(value)
        found[name] = {"mean": value.mean, "low": low, "high": high}
    return found


def _means(measure: Measure, drawn: Array) -> Float[Array, "n"]:
    counts = measure.counts[drawn].sum(axis=1)
    sums = measure.sums[drawn].sum(axis=1)
    return np.where(counts > 0, sums / np.maximum(counts, 1e-9), np.nan)


def _final(futures: Float[Tensor, "S K T A 4"], segments: Segments) -> Float[Tensor, "S K A"]:
    return (futures[:, :, -1, :, :2] - segments.states[:, None, -1, :, :2]).norm(dim=-1)


def _spread(futures: Float[Tensor, "S K T A 4"]) -> Float[Tensor, "S A"]:
    """The largest distance between two samples' ends."""
    ends = futures[:, :, -1, :, :2].transpose(1, 2)
    return (ends[:, :, :, None] - ends[:, :, None]).norm(dim=-1).amax(dim=(2, 3))


def _rates(
    futures: Float[Tensor, "S K T A 4"], segments: Segments, observed: int, rules: Rules
) -> dict[str, Measure]:
    """Shares of agents, samples and steps with a collision, off the road, through a red light."""
    samples = futures.shape[1]
    poses = futures[:, :, observed - 1 :, :, :3]
    there = segments.present[:, None, observed - 1 :].expand(-1, samples, -1, -1)
    after, now = poses[:, :, 1:], there[:, :, 1:]
    mine = now & segments.controlled[:, None, None]
    sizes = segments.sizes[:, None, None].expand(*now.shape, 2)
    flat = after.flatten(0, 2), sizes.flatten(0, 2), now.flatten(0, 2)
    hits = (collisions(*flat) > 0).view(now.shape)
    found = {"collision rate": _rate(hits, mine)}
    driven = mine & (segments.planes == VEHICLE)[:, None, None]
    if rules.drivable is not None and driven.any():
        off = offroad_distance(rules.drivable, after, sizes, driven) > 0
        found["off-road rate"] = _rate(off, driven)
    told = (segments.lights[:, observed - 1 : -1] != UNKNOWN).any(dim=2)[:, None, :, None]
    if told.any() and driven.any():
        ran = _ran_red(poses, segments, observed, driven)
        found["red-light rate"] = _rate(ran, driven & told)
    return found


def _ran_red(
    poses: Float[Tensor, "S K _ A 3"], segments: Segments, observed: int, driven: Tensor
) -> Bool[Tensor, "S K t A"]:
    """Who crosses a line in a step while its light is red."""
    shape = driven.shape[:3]
    lights = segments.lights[:, None, observed - 1 : -1]
    each = (
        poses[:, :, :-1],
        poses[:, :, 1:],
        segments.sizes[:, None, None, :, 0],
        driven,
        segments.lines[:, None, None],
        lights,
    )
    flat = (x.expand(*shape, *x.shape[3:]).flatten(0, 2) for x in each)
    return ran_red(*flat).view(driven.shape)


def _rate(wrong: Bool[Tensor, "S K t A"], who: Bool[Tensor, "S K t A"]) -> Measure:
    return _measure((wrong & who).sum(dim=(1, 2, 3)), who.sum(dim=(1, 2, 3)))


def _measure(sums: Tensor, counts: Tensor) -> Measure:
    return Measure(sums.double().cpu().numpy(), counts.double().cpu().numpy())
