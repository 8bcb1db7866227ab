"""Reports: tables of metrics, and curves of a training."""

import os
from collections.abc import Mapping
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from geoaim.base.files import write_figure

CURVES = {
    "nll": "negative log-likelihood",
    "kl": "KL divergence, nats",
    "anchor": "loss of proposals, m",
    "val_loss": "loss in validation",
    "minADE": "minADE in validation, m",
}


def plot_training(log: str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Plot a training's `log.csv` as a PNG: a panel for each loss and for minADE, by steps."""
    table = pd.read_csv(Path(log)).set_index("step")
    columns = [name for name in CURVES if table[name].any()]
    figure = Figure(figsize=(4 * len(columns), 3), layout="constrained")
    panels = figure.subplots(1, len(columns), squeeze=False)[0]
    for axes, name in zip(panels, columns, strict=True):
        axes.plot(table.index, table[name], ".-", color="#ff6a00")
        axes.set(title=CURVES[name], xlabel="steps")
        axes.set_yscale("log" if name == "nll" else "linear")
        axes.grid(alpha=0.3)
    write_figure(figure, path)


def format_cell(value: Mapping[str, float]) -> str:
    """Format a metric's summary: its mean, with the interval if it has one.

    >>> format_cell({"mean": 1.0, "low": 0.9, "high": 1.1})
    '1 (0.9 to 1.1)'
    """
    if "low" not in value:
        return f"{value['mean']:.3g}"
    return f"{value['mean']:.3g} ({value['low']:.3g} to {value['high']:.3g})"
