"""Averages of metrics over trainings, places and pieces of a recording."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.prediction.metrics import BOOTSTRAP_DRAWS, CONFIDENCE, Metric


def bootstrap_trainings(
    trainings: Sequence[Sequence[Metric]], others: Sequence[Sequence[Metric]] = (), *, seed: int = 0
) -> tuple[float, float]:
    """Estimate the interval of a mean over trainings and places, or of the difference of two.

    Trainings and places are resampled, each as a whole (hierarchical bootstrap, Davison and Hinkley
    1997), so that the interval tells what other trainings and other places would give.

    Args:
        trainings: the metric of each training of a model at each place.
        others: of another model at the same places, subtracted; its trainings are resampled on
            their own.
        seed: seed of the resampling.

    Returns:
        Lower and upper bound of the 95 % interval.

    Raises:
        ValueError: there is one training or one place, over which there is no interval.

    >>> places = [Metric(np.array([x]), np.ones(1)) for x in (1.0, 3.0)]
    >>> low, high = bootstrap_trainings([places, places])
    >>> low, high
    (1.0, 3.0)
    """
    generator = np.random.default_rng(seed)
    places = len(trainings[0]) if trainings else 0
    if min(places, len(trainings), *([len(others)] if others else [])) < 2:
        raise ValueError(f"{len(trainings)} trainings at {places} places; two of each are needed")
    chosen = generator.integers(0, places, (BOOTSTRAP_DRAWS, places))
    means = _draw_trainings(trainings, chosen, generator)
    if others:
        means = means - _draw_trainings(others, chosen, generator)
    low, high = np.nanquantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def average_seeds(trainings: Sequence[Mapping[str, Metric]]) -> dict[str, Metric]:
    """Average metrics of trainings with different seeds on the same segments.

    Intervals are over segments; they do not tell how much trainings differ.
    """
    return {
        name: Metric(
            np.mean([metrics[name].sums for metrics in trainings], axis=0),
            np.mean([metrics[name].counts for metrics in trainings], axis=0),
        )
        for name in trainings[0]
    }


def merge_segments(metrics: Mapping[str, Metric]) -> dict[str, Metric]:
    """Merge segments of the same time and place into one, which has no interval."""
    return {
        name: Metric(metric.sums.sum(keepdims=True), metric.counts.sum(keepdims=True))
        for name, metric in metrics.items()
    }


def _draw_trainings(
    trainings: Sequence[Sequence[Metric]], places: Int[Array, "D P"], generator: np.random.Generator
) -> Float[Array, "D"]:
    """Means of resampled trainings at resampled places."""
    sums, counts = (
        np.array([[getattr(one, part).sum() for one in row] for row in trainings])  # (R, P)
        for part in ("sums", "counts")
    )
    rows = generator.integers(0, len(sums), (len(places), len(sums)))
    index = rows[:, :, None], places[:, None, :]
    total, number = sums[index].sum(axis=(1, 2)), counts[index].sum(axis=(1, 2))
    return np.where(number > 0, total / np.maximum(number, 1e-9), np.nan)
