"""Metrics of predicted futures, each with its sums for every segment.

Bootstrap intervals need the segments, hence the sums and counts instead of means.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from torch import Tensor

from geoaim.prediction.segments import VEHICLE, Segments, mark_steps_until_leaving, repeat
from geoaim.simulation.input_checks import check_shape
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules, move_rules_to_any
from geoaim.simulation.scene_infractions import AgentMotion, find_infractions

MIN_JUDGED_S = 1.0  # agents that leave sooner after the last observed step have no displacement
BOOTSTRAP_DRAWS = 1000
CONFIDENCE = 0.95
MIN_SEGMENTS = 10  # fewer have no interval: their bootstrap is too narrow
# names of metrics by those of infractions
RATES = {"collision": "collision rate", "off road": "off-road rate", "red light": "red-light rate"}


@dataclass(frozen=True, eq=False)
class Metric:
    """A quantity that is averaged over agents, samples or steps of B segments."""

    sums: Float[Array, "B"]  # sum over each segment
    counts: Float[Array, "B"]  # number of summands in each segment

    @property
    def mean(self) -> float:
        """Mean over all summands of all segments; NaN without any."""
        total = self.counts.sum()
        return float(self.sums.sum() / total) if total else float("nan")


def compute_metrics(
    futures: Float[Tensor, "B K N T 4"],
    segments: Segments,
    history: int,
    rules: RoadRules = NO_ROAD_RULES,
) -> dict[str, Metric]:
    """Compute all metrics of controlled agents.

    Displacements are those of agents that are present at the last observed step and for
    `MIN_JUDGED_S` after it, or to the end of shorter segments: over the steps until they leave, and
    at the last of these. Rates count all agents at the steps at which they are there.

    - `minADE`, `minFDE`: average and final displacement error of the best of K samples, chosen for
      each agent (Gupta et al. 2018).
    - `joint minADE`, `joint minFDE`: the same, one sample chosen for all agents of a segment (Liu
      et al. 2023), and a mean over segments instead of agents. Each chooses its own sample.
    - `MFD`: maximum final distance between two samples (Ścibior et al. 2021).
    - `collision rate`, `off-road rate`: share of agents, samples and predicted steps (Lioutas et
      al. 2021), by `find_infractions`; contacts count as collisions here.
      `red-light rate`: the same, of vehicles' steps that start with known lights. Rates without any
      summand are left out.

    Args:
        futures: states of all agents, observed steps included.
        segments: the ground truth.
        history: observed steps.
        rules: road rules (where vehicles may drive), moved to the segments' world.

    Returns:
        Metrics by name: displacements in metres, rates between 0 and 1.

    Raises:
        ValueError: the futures have another shape than the segments, or no samples.
        MapError: the rules are of a world from which moving is not exact.
    """
    check_futures(futures, segments, history)
    rules = move_rules_to_any(rules, segments.worlds)
    judged = select_agents_to_judge(segments, history)
    count = judged.sum(dim=1)
    metrics = {}
    ends = _gather_ends(futures, segments, history)  # (B, K, N, 2)
    truth = _gather_ends(segments.states[:, None], segments, history)
    errors_at_end = (ends - truth).norm(dim=-1)
    for name, errors in (("ADE", compute_ade(futures, segments, history)), ("FDE", errors_at_end)):
        best = torch.where(judged, errors.amin(dim=1), 0.0).sum(dim=1)
        metrics[f"min{name}"] = _make_metric(best, count)
        joint = torch.where(judged[:, None], errors, 0.0).sum(dim=2).amin(dim=1)
        metrics[f"joint min{name}"] = _make_metric(joint / count.clamp_min(1), count.sign())
    distances = (ends[:, :, None] - ends[:, None]).norm(dim=-1).amax(dim=(1, 2))  # (B, N)
    mfd = torch.where(judged, distances, 0.0).sum(dim=1)
    metrics["MFD"] = _make_metric(mfd, count)
    return metrics | _compute_infraction_rates(futures, segments, history, rules)


def check_futures(
    futures: Float[Tensor, "B K N T 4"],
    segments: Segments,
    history: int,
    samples: int | None = None,
) -> None:
    """Check what a predictor returned.

    Args:
        futures: states of all agents.
        segments: the segments that it predicted.
        history: observed steps.
        samples: K, the number that was asked for; None: any.

    Raises:
        ValueError: futures have another shape, axes in another order, or a state of a controlled
            agent that is not finite.
    """
    given = futures.shape[1] if samples is None and futures.ndim == 5 else samples or 1
    check_shape(
        "futures (segments, samples, agents, steps, 4)",
        futures,
        (len(segments), max(1, given), segments.agents, segments.steps, 4),
    )
    finite = futures[..., history:, :].isfinite().flatten(3).all(dim=3).all(dim=1)  # (B, N)
    if not finite[segments.controlled].all():
        raise ValueError("futures: a controlled agent has a state that is not finite")


def compute_ade(
    futures: Float[Tensor, "B K N T 4"], segments: Segments, history: int
) -> Float[Tensor, "B K N"]:
    """Compute the average displacement error of every sample.

    Args:
        futures: states of all agents, observed steps included.
        segments: the ground truth.
        history: observed steps.

    Returns:
        Mean distance from the ground truth over the predicted steps until an agent leaves, metres;
        0 for agents that are absent at the last observed step or the next one.
    """
    followed = mark_steps_until_leaving(segments, history)
    offsets = futures[..., history:, :2] - segments.states[:, None, :, history:, :2]
    distances = torch.where(followed[:, None], offsets.norm(dim=-1), 0.0)
    return distances.sum(dim=-1) / followed.sum(dim=-1).clamp_min(1)[:, None]


def select_agents_to_judge(segments: Segments, history: int) -> Bool[Tensor, "B N"]:
    """Select the controlled agents whose displacements are judged, as `compute_metrics` says."""
    horizon = segments.steps - history
    least = min(horizon, math.ceil(MIN_JUDGED_S / segments.dt - 1e-6))
    return segments.controlled & (mark_steps_until_leaving(segments, history).sum(dim=2) >= least)


def _gather_ends(
    states: Float[Tensor, "B k N T 4"], segments: Segments, history: int
) -> Float[Tensor, "B k N 2"]:
    """Positions at the last predicted step before an agent leaves."""
    last = history - 1 + mark_steps_until_leaving(segments, history).sum(dim=2)  # (B, N)
    index = last[:, None, :, None, None].expand(-1, states.shape[1], -1, 1, 2)
    return states[..., :2].gather(3, index)[..., 0, :]


def bootstrap_interval(
    metric: Metric, other: Metric | None = None, *, seed: int = 0
) -> tuple[float, float]:
    """Estimate the confidence interval of a mean, or of the difference from another mean.

    It is made of percentiles of the bootstrap over segments (Efron 1979).

    Args:
        metric: a metric of B segments.
        other: a metric of the same segments, subtracted in each resample.
        seed: seed of the resampling; with one seed, two metrics are resampled alike.

    Returns:
        Lower and upper bound of the 95 % interval.

    >>> low, high = bootstrap_interval(Metric(np.array([1.0, 2.0, 3.0]), np.ones(3)))
    >>> bool(1 <= low < 2 < high <= 3)
    True
    """
    generator = np.random.default_rng(seed)
    count = len(metric.sums)
    draws = generator.integers(0, count, (BOOTSTRAP_DRAWS, count))
    means = _average_draws(metric, draws)
    if other is not None:
        means = means - _average_draws(other, draws)
    low, high = np.nanquantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def concat(parts: Sequence[Mapping[str, Metric]]) -> dict[str, Metric]:
    """Concatenate metrics of sets of segments; a set without a metric adds nothing to it."""
    metrics = {}
    for name in dict.fromkeys(name for part in parts for name in part):
        rows = [part[name] if name in part else _make_empty(part) for part in parts]
        metrics[name] = Metric(
            np.concatenate([row.sums for row in rows]), np.concatenate([row.counts for row in rows])
        )
    return metrics


def keep_rates(metrics: Mapping[str, Metric]) -> dict[str, Metric]:
    """Keep the rates of infractions, the only metrics of a recording itself."""
    return {name: metric for name, metric in metrics.items() if name.endswith(" rate")}


def summarise(metrics: Mapping[str, Metric]) -> dict[str, dict[str, float]]:
    """Summarise each metric by its mean, its 95 % interval, and what it is the mean of.

    Returns:
        By name "mean"; "low" and "high", of `MIN_SEGMENTS` or more; "count" of summands, which
        for displacements are agents; and "segments" that have any.
    """
    summary = {}
    for name, metric in metrics.items():
        segments = int((metric.counts > 0).sum())
        summary[name] = {"mean": metric.mean, "count": float(metric.counts.sum())}
        summary[name]["segments"] = segments
        if segments >= MIN_SEGMENTS:
            summary[name]["low"], summary[name]["high"] = bootstrap_interval(metric)
    return summary


def _compute_infraction_rates(
    futures: Float[Tensor, "B K N T 4"], segments: Segments, history: int, rules: RoadRules
) -> dict[str, Metric]:
    """Shares of agents, samples and steps that collide, are off the road or run a red light."""
    count, samples = futures.shape[:2]
    many = repeat(segments, samples)  # (B K, ...)
    motion = AgentMotion(
        poses=futures[..., history - 1 :, :3].flatten(0, 1),
        present=many.present[..., history - 1 :],
        sizes=many.sizes,
        vehicles=many.layers == VEHICLE,
        stop_lines=many.stop_lines,
        light_states=many.light_states[:, history - 1 : -1],
    )
    drivable = RoadRules(rules.drivable)  # the wrong way is not counted
    found = find_infractions(motion, many.controlled, drivable)
    collided, judged = found.pop("collision")
    found["collision"] = collided | found["contact"][0], judged
    return {
        rate: _make_metric(*(x.reshape(count, -1).sum(dim=1) for x in (marks & on, on)))
        for name, rate in RATES.items()
        if name in found
        for marks, on in [found[name]]
        if name == "collision" or on.any()
    }


def _average_draws(metric: Metric, draws: Int[Array, "D B"]) -> Float[Array, "D"]:
    counts = metric.counts[draws].sum(axis=1)
    sums = metric.sums[draws].sum(axis=1)
    return np.where(counts > 0, sums / np.maximum(counts, 1e-9), np.nan)


def _make_metric(sums: Tensor, counts: Tensor) -> Metric:
    return Metric(sums.double().cpu().numpy(), counts.double().cpu().numpy())


def _make_empty(part: Mapping[str, Metric]) -> Metric:
    zeros = np.zeros_like(next(iter(part.values())).sums)
    return Metric(zeros, zeros)
