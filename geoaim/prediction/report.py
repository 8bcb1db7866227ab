"""Reports: tables of metrics, and curves of a training."""

import os
from collections.abc import Mapping
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from geoaim.base.files import write_figure

Summary = Mapping[str, Mapping[str, float]]
CURVES = {
    "nll": "negative log-likelihood",
    "kl": "KL divergence, nats",
    "anchor": "loss of proposals, m",
    "val_loss": "loss in validation",
    "minADE": "minADE in validation, m",
}


def format_markdown(summaries: Mapping[str, Summary]) -> str:
    """Format summaries (see `summarise`) as a table, a row for each method by its name.

    The numbers of agents and segments are those of the first metric.

    >>> value = {"mean": 1.0, "low": 0.9, "high": 1.1, "count": 20, "segments": 3}
    >>> print(format_markdown({"a": {"minADE": value}}))
    | | agents | segments | minADE |
    | --- | --- | --- | --- |
    | a | 20 | 3 | 1 (0.9 to 1.1) |
    """
    names = list(dict.fromkeys(name for summary in summaries.values() for name in summary))
    columns = ["", "agents", "segments", *names]
    lines = [_format_row(columns), "|" + " --- |" * len(columns)]
    for method, summary in summaries.items():
        cells = [format_cell(summary[name]) if name in summary else "" for name in names]
        first = summary.get(names[0])
        counts = [f"{first['count']:.0f}", f"{first['segments']:.0f}"] if first else ["", ""]
        lines.append(_format_row([method, *counts, *cells]))
    return "\n".join(lines)


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


def _format_row(cells: list[str]) -> str:
    return " ".join(f"| {cell}".rstrip() for cell in cells) + " |"


def format_cell(value: Mapping[str, float]) -> str:
    """Format a metric's summary: its mean, with the interval if it has one.

    >>> format_cell({"mean": 1.0, "low": 0.9, "high": 1.1})
    '1 (0.9 to 1.1)'
    """
    if "low" not in value:
        return f"{value['mean']:.3g}"
    return f"{value['mean']:.3g} ({value['low']:.3g} to {value['high']:.3g})"
