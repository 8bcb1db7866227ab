"""Charts of benchmarks: error against time with the Pareto front, error and cost against sizes."""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from matplotlib.transforms import Bbox
from numpy import ndarray as Array

from geoaim.bench.curves import find_best_size, find_pareto_front
from geoaim.bench.report import Row

# of Okabe and Ito, told apart by colour-blind readers; the marks differ as well
OURS, OTHERS, KNEE = "#D55E00", "#0072B2", "#009E73"
DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
LABEL_PX = (7.0, 14.0, 28.0)  # tried between a mark and its label


def draw_fronts(
    panels: Mapping[str, Sequence[Row]], *, cost: str, error: str, labels: tuple[str, str]
) -> Figure:
    """Draw error against cost with the Pareto front, a panel for each group of methods.

    Args:
        panels: rows by title, each with "method"; names that begin with "geoaim" are ours.
        cost: key of the cost.
        error: key of the error.
        labels: of the two axes.

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
        _scale_axes(axes)
    figure.draw_without_rendering()  # so that the axes have their sizes
    for axes, rows in zip(figure.axes, panels.values(), strict=True):
        points = np.array([[row[cost], row[error]] for row in rows], float)
        label_points(axes, points, [row["method"] for row in rows])
    return figure


def draw_sizes(rows: Sequence[Row], labels: Mapping[str, str]) -> Figure:
    """Draw error and time against each size, with the default and the knee.

    Args:
        rows: as `summarise_sizes` takes them, with "ms".
        labels: of the error, by setting.

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
    _scale_axes(axes)
    axes.set_xticks(x, [f"{size:.4g}" for size in x], fontsize=8)


def _scale_axes(axes: Axes) -> None:
    """Make both axes logarithmic, with plain numbers and a grid."""
    axes.set(xscale="log", yscale="log")
    axes.grid(alpha=0.25)
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        subs = (
            (1.0, 1.5, *range(2, 10)) if high < 4 * low else (1, 2, 5) if high < 200 * low else (1,)
        )
        axis.set_major_locator(LogLocator(subs=subs))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())


def label_points(axes: Axes, points: Float[Array, "n 2"], names: Sequence[str]) -> None:
    """Write each point's name beside it, where it covers no point and no other name.

    Args:
        axes: whose figure has its layout.
        points: in the axes' data.
        names: of the points.
    """
    shown, frame = np.isfinite(points).all(1), axes.bbox.frozen()
    places = axes.transData.transform(points[shown])
    taken = [Bbox.from_extents(*(place - 4), *(place + 4)) for place in places]
    for place, point, name in zip(places, points[shown], np.array(names)[shown], strict=True):
        text = axes.annotate(str(name), point, xytext=(0, 0), textcoords="offset points")
        text.set(fontsize=8, color=OURS if name.startswith("geoaim") else "0.2")
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8})
        size = np.array(text.get_window_extent().size)
        boxes = [
            Bbox.from_bounds(*(place + gap * np.array(way) + (np.array(way) - 1) / 2 * size), *size)
            for gap, way in product(LABEL_PX, DIRECTIONS)
        ]
        others = places[(places != place).any(1)]
        best = min(boxes, key=lambda box: _count_conflicts(box, taken, frame, (place, others)))
        text.xyann = tuple((best.min - place) * 72 / text.figure.dpi)
        taken.append(best)


def _count_conflicts(
    box: Bbox, taken: list[Bbox], frame: Bbox, places: tuple[Float[Array, "2"], Float[Array, "m 2"]]
) -> int:
    """Count boxes that a name overlaps, sides of the frame that it crosses, and points that are
    as near to it as its own."""
    crossed = sum([box.x0 < frame.x0, box.x1 > frame.x1, box.y0 < frame.y0, box.y1 > frame.y1])
    own, others = (np.linalg.norm(p - p.clip(box.min, box.max), axis=-1) for p in places)
    return int(2 * box.count_overlaps(taken) + 4 * crossed + (others < own + 3).sum())
