"""Charts of benchmarks: error against time with the Pareto front, error and cost against sizes."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.curves import find_best_size, find_pareto_front
from benchmarks.results import Row
from geoaim.base.labels import label_points, scale_axes

# colours of Okabe and Ito, which colour-blind readers can tell apart; the marks differ as well
OURS, OTHERS, KNEE = "#D55E00", "#0072B2", "#009E73"


def draw_fronts(
    panels: Mapping[str, Sequence[Row]], *, cost: str, error: str, labels: tuple[str, str]
) -> Figure:
    """Draw error against cost with the Pareto front, a panel for each group of methods.

    Args:
        panels: rows by title, each with "method"; names that begin with "geoaim" are ours.
        cost: key of the cost.
        error: key of the error.
        labels: labels of the two axes.

    Returns:
        The chart, with logarithmic axes.
    """
    columns = 2 if len(panels) == 4 else min(len(panels), 3)
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(4.6 * columns + 0.4, 3.8 * lines), layout="constrained")
    grid = figure.subplots(lines, columns, squeeze=False)
    for axes in grid.ravel()[len(panels) :]:
        axes.remove()
    for axes, (title, rows) in zip(figure.axes, panels.items(), strict=True):
        x, y = (np.array([row[key] for row in rows], float) for key in (cost, error))
        on = np.flatnonzero(find_pareto_front(x, y))
        on = on[np.argsort(x[on])]
        axes.step(x[on], y[on], where="post", color="0.6", linewidth=1, zorder=1)
        for row, u, v in zip(rows, x, y, strict=True):
            ours = row["method"].startswith("geoaim")
            axes.plot(u, v, "D" if ours else "o", color=OURS if ours else OTHERS, markersize=6)
        axes.set(title=title, xlabel=labels[0], ylabel=labels[1])
        axes.margins(0.2)
        scale_axes(axes)
    figure.draw_without_rendering()  # so that the axes have their sizes
    for axes, rows in zip(figure.axes, panels.values(), strict=True):
        points = np.array([[row[cost], row[error]] for row in rows], float)
        for text in label_points(axes, points, [row["method"] for row in rows]):
            text.set_color(OURS if text.get_text().startswith("geoaim") else "0.2")
    return figure


def draw_sizes(rows: Sequence[Row], labels: Mapping[str, str]) -> Figure:
    """Draw the error and the time of each setting against its size; mark default and knee.

    Args:
        rows: the rows that `summarise_sizes` takes, with their times as "ms".
        labels: labels of the error axis, by the name of the setting.

    Returns:
        The chart: a column for each setting, error above time.
    """
    figure = Figure(figsize=(3.4 * len(labels) + 0.4, 5.4), layout="constrained")
    grid = figure.subplots(2, len(labels), squeeze=False, sharex="col")
    for column, (name, error) in enumerate(labels.items()):
        own = [row for row in rows if row["setting"] == name]
        for axes, key, text in zip(grid[:, column], ("error", "ms"), (error, "ms"), strict=True):
            _draw_size(axes, own, key)
            axes.set_ylabel(text)
        grid[1, column].set_xlabel(name)
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def _draw_size(axes: Axes, rows: Sequence[Row], key: str) -> None:
    """Draw one quantity against a size."""
    sizes = [row for row in rows if not row.get("automatic")]
    default = next(row for row in rows if row["default"])
    knee = find_best_size(rows)
    x = [row["size"] for row in sizes]
    axes.plot(x, [row[key] for row in sizes], "o-", color=OTHERS, markersize=4)
    axes.plot(default["size"], default[key], "D", color=OURS, markersize=8, label="default")
    [ring] = axes.plot(knee["size"], knee[key], "o", color=KNEE, markersize=14, label="knee")
    ring.set(fillstyle="none", markeredgewidth=2)
    if default.get("automatic"):
        place = default["size"], default[key]
        text = axes.annotate("automatic", place, (0, 8), textcoords="offset points", ha="center")
        text.set(color=OURS, fontsize=8)
    axes.margins(0.18, 0.12)
    scale_axes(axes)
    axes.set_xticks(x, [f"{size:.4g}" for size in x], fontsize=8)
