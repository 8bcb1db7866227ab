"""Synthetic places against real ones: statistics of their images and of their agents' motion.

The distance of two distributions is the Kolmogorov-Smirnov statistic: 0 for equal and 1 for
disjoint ones. Real sources differ from each other too; their distances are the yardstick. Spectra
are compared by the amplitude of each octave, in decibels.

    python -m benchmarks.realism --json docs/bench/realism.json \
        --chart docs/images/realism.png
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import scipy.stats
import typer
from jaxtyping import Float
from matplotlib.axes import Axes
from numpy import ndarray as Array

from benchmarks.data import require_data
from benchmarks.realism.images import OCTAVES, draw_sample, read_real_images, sample_statistics
from benchmarks.realism.motion import (
    VEHICLES,
    Statistics,
    concat_statistics,
    measure_motion,
    read_real_pedestrians,
    read_real_vehicles,
)
from benchmarks.results import ChartFile, JsonFile, format_table, write_rows
from benchmarks.synthetic import make_sample, tracks_of
from benchmarks.synthetic.roads.layouts import STANDARD_KINDS
from geoaim.tracks.tracks import Tracks

MIN_VALUES = 50  # a statistic of fewer values is not compared
Groups = dict[str, tuple[list[Statistics], dict[str, Statistics]]]  # synthetic, real by source


def main(
    seeds: Annotated[int, typer.Option(help="synthetic places of each kind")] = 2,
    minutes: Annotated[float, typer.Option(help="minutes of traffic in each")] = 3.0,
    json: JsonFile = None,
    chart: ChartFile = None,
) -> None:
    """Compare synthetic places with the real data."""
    folder = require_data()
    samples = [
        make_sample(seed, kind=kind, minutes=minutes, video=None)
        for kind in STANDARD_KINDS
        for seed in range(1, seeds + 1)
    ]
    synthetic, real = [draw_sample(s) for s in samples], read_real_images(folder)
    tracks = [tracks_of(sample) for sample in samples]
    vehicles, pedestrians = read_real_vehicles(folder), read_real_pedestrians(folder)
    groups: Groups = {
        "image": (
            [sample_statistics(image) for image in synthetic],
            {name: sample_statistics(image) for name, image in real.items()},
        ),
        "vehicles": _measure_group(tracks, vehicles, VEHICLES),
        "pedestrians": _measure_group(tracks, pedestrians, ("pedestrian",)),
        "cyclists": _measure_group(tracks, pedestrians, ("cyclist",)),
    }
    rows = [row for name, (own, others) in groups.items() for row in _compare(name, own, others)]
    print(format_table(rows))
    command = f"python -m benchmarks.realism --seeds {seeds} --minutes {minutes:g}"
    write_rows(rows, json, command=command)
    if chart is not None:
        _draw_chart(groups, chart)


def _measure_group(
    synthetic: list[Tracks], real: Mapping[str, list[Tracks]], types: tuple[str, ...]
) -> tuple[list[Statistics], dict[str, Statistics]]:
    """Measure the motion of agents of some types, in synthetic and in real tracks."""
    return (
        [measure_motion(tracks, types) for tracks in synthetic],
        {name: measure_motion(recordings, types) for name, recordings in real.items()},
    )


def _compare(
    group: str, synthetic: Sequence[Statistics], real: Mapping[str, Statistics]
) -> Iterator[dict[str, Any]]:
    """Compare synthetic with real statistics, and real sources with each other; rows of a table."""
    together = concat_statistics(synthetic)
    for name, values in together.items():
        sources = [s[name] for s in real.values() if len(s[name]) >= MIN_VALUES]
        if not sources or len(values) < MIN_VALUES:
            continue
        is_spectrum = name == "spectrum"
        measure = _measure_spectrum_distance if is_spectrum else _measure_distribution_distance
        to_real = [measure(values, source) for source in sources]
        among_real = [measure(a, b) for a, b in combinations(sources, 2)]
        row: dict[str, Any] = {"group": group, "statistic": name}
        if not is_spectrum:
            for label, part in (("synthetic", values), ("real", np.concatenate(sources))):
                row |= {f"{label} {q} %": float(np.percentile(part, q)) for q in (10, 50, 90)}
        row |= {
            "synthetic to real": float(np.median(to_real)),
            "real to real": float(np.median(among_real)) if among_real else float("nan"),
            "real to real, max": float(np.max(among_real)) if among_real else float("nan"),
            "sources": len(sources),
        }
        yield row


def _measure_distribution_distance(a: Float[Array, "_"], b: Float[Array, "_"]) -> float:
    return float(scipy.stats.ks_2samp(a, b, method="asymp").statistic)


def _measure_spectrum_distance(a: Float[Array, "_"], b: Float[Array, "_"]) -> float:
    """Root mean square difference of two spectra over octaves, dB."""
    octaves = len(OCTAVES) - 1
    levels = [20 * np.log10(s.reshape(-1, octaves)).mean(axis=0) for s in (a, b)]
    return float(np.sqrt(((levels[0] - levels[1]) ** 2).mean()))


def _draw_chart(groups: Groups, path: Path) -> None:
    """Draw cumulative distributions: the synthetic one thick, each real source thin."""
    panels = [
        (group, name)
        for group, (synthetic, real) in groups.items()
        for name in synthetic[0]
        if name not in ("spectrum", "share of time standing")
        and sum(len(s[name]) >= MIN_VALUES for s in real.values()) > 0
        and len(concat_statistics(synthetic)[name]) >= MIN_VALUES
    ]
    columns = 5
    rows = -(-len(panels) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(17, 2.6 * rows), layout="constrained")
    axes = axes.ravel()
    for axis, (group, name) in zip(axes, panels, strict=False):
        synthetic, real = groups[group]
        for source, statistics in real.items():
            _draw_distribution(axis, statistics[name], source, width=1.0)
        _draw_distribution(axis, concat_statistics(synthetic)[name], "synthetic", width=2.4)
        axis.set_title(f"{group}: {name}", fontsize=9)
        axis.legend(fontsize=6)
    for axis in axes[len(panels) :]:
        axis.axis("off")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)


def _draw_distribution(axis: Axes, values: Float[Array, "_"], label: str, *, width: float) -> None:
    if len(values) < MIN_VALUES:
        return
    shares = np.linspace(0, 1, 201)
    axis.plot(np.quantile(values, shares), shares, label=label, linewidth=width)
    low, high = np.quantile(values, [0.01, 0.99])
    left, right = axis.get_xlim() if len(axis.lines) > 1 else (low, high)
    axis.set_xlim(min(left, low), max(right, high))
