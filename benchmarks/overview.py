"""One picture of all stages: time against error, from the results in docs/bench.

python -m benchmarks.overview -o docs/images/speed_accuracy.png
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from json import loads
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.charts import OTHERS, OURS
from benchmarks.prediction.speed import DEFAULT, NUMBERS, OTHER_METHODS
from benchmarks.results import ROOT
from geoaim.base.labels import label_points, scale_axes

BENCH, EXPERIMENTS = ROOT / "docs" / "bench", ROOT / "docs" / "experiments"
# a method with its time and error
Point = tuple[str, float, float]
MIN_IDF1_ERROR = 1e-3  # tracks without error are drawn here, since the axis is logarithmic


@dataclass(frozen=True)
class Panel:
    """One stage of the picture."""

    title: str
    cost: str  # label of the axis
    error: str
    read: Callable[[], Iterator[Point]]
    ours: str  # name of our default
    limit: float | None = None  # what no method is faster than
    bounded_by: str = ""


def read_fronts(name: str, data: str, error: str) -> Iterator[Point]:
    """Read the rows of fronts of a benchmark for one kind of data."""
    for row in _read(name)["fronts"]:
        if row["data"] == data:
            yield row["method"], row["ms"], row[error]


def read_detection() -> Iterator[Point]:
    """Read what the detector misses and invents by the scale that it is told."""
    for row in _read("detection")["wrong_scale"]:
        f1 = 2 * row["recall"] * row["precision"] / (row["recall"] + row["precision"])
        name = f"scale times {row['told over true']:g}"
        default = row["told over true"] == 1
        yield "geoaim" if default else name, 1e3 * row["seconds a frame of 0.15 m"], 1 - f1


def read_tracking() -> Iterator[Point]:
    """Read the trackers' mean error over all kinds of boxes."""
    rows = [row for row in _read("tracking_hard")["rows"] if row["agents of"] == "vehicle"]
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method and "ms a frame" in row]
        if own and "not given" not in method:
            error = max(1 - fmean(row["IDF1"] for row in own), MIN_IDF1_ERROR)
            yield method, fmean(row["ms a frame"] for row in own), error


def read_alignment() -> Iterator[Point]:
    """Read the methods that align imagery, whose failures count with their median."""
    rows = [row for row in _read("alignment")["rows"] if "method" in row]
    for row in rows:
        yield row["method"], row["s"], row["median, px"]


def read_drawing() -> Iterator[Point]:
    """Read the ways to draw views."""
    for row in _read("birdview")["methods"]:
        yield row["method"], row["ratio to grid_sample"], row["mean error"]


def read_georeference() -> Iterator[Point]:
    """Read the transform models of control points."""
    return read_fronts("georeference", "6 points", "error, px")


def read_prediction() -> Iterator[Point]:
    """Read the predictors of vehicles; cells are a mean and, in brackets, the range of places."""
    for row in loads((EXPERIMENTS / "speed.json").read_text("utf-8"))["speed"]:
        name = row["predictor"]
        if name not in OTHER_METHODS:
            name = "geoaim" if name == DEFAULT else f"geoaim, {name}"
        cost, error = (float(row[key].split()[0]) for key in NUMBERS[:2])
        yield name, cost, error


PANELS = (
    Panel(
        "Register a frame (1080p, H.264)",
        "ms a frame",
        "error, px",
        lambda: read_fronts("registration", "1080p, H.264", "error, px"),
        "geoaim",
    ),
    Panel(
        "Remove a queue (hover video)",
        "ms a frame",
        "error, grey levels",
        lambda: read_fronts("background", "hover video 00003", "stood"),
        "geoaim",
    ),
    Panel("Georeference by 6 points", "ms", "error, px", read_georeference, "geoaim"),
    Panel("Align imagery of another day", "s", "median error, px", read_alignment, "geoaim"),
    Panel(
        "Detect vehicles in a 1080p frame",
        "ms a frame",
        "1 - F1, in pictures never seen",
        read_detection,
        "geoaim",
    ),
    Panel("Track hard boxes", "ms a frame", "1 - IDF1", read_tracking, "geoaim"),
    Panel(
        "Draw 16 views of 256 px",
        "time over that of grid_sample",
        "mean error, grey levels",
        read_drawing,
        "geoaim",
        1.0,
        "grid_sample alone",
    ),
    Panel(
        "Predict vehicles 5 s ahead, 6 futures",
        "ms an agent",
        "minADE, m",
        read_prediction,
        "geoaim",
    ),
)


def draw_stages(panels: Sequence[Panel]) -> Figure:
    """Draw the methods of each stage, error against time."""
    columns = 2
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(9, 3.3 * lines), layout="constrained")
    grid = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes in grid[len(panels) :]:
        axes.remove()
    drawn = [(axes, _draw(axes, panel)) for axes, panel in zip(grid, panels, strict=False)]
    figure.draw_without_rendering()  # so that the axes have their sizes
    for axes, points in drawn:
        places = np.array([point[1:] for point in points], float)
        for text in label_points(axes, places, [point[0] for point in points]):
            text.set(color=OURS if text.get_text().startswith("geoaim") else "0.2", fontsize=8)
    return figure


def _draw(axes: Axes, panel: Panel) -> list[Point]:
    points = list(panel.read())
    for name, cost, error in points:
        is_default, is_ours = name == panel.ours, name.startswith(("geoaim", "scale"))
        mark = "*" if is_default else "D" if is_ours else "o"
        size = 12 if is_default else 6
        axes.plot(cost, error, mark, color=OURS if is_ours else OTHERS, markersize=size)
    if panel.limit is not None:
        axes.axvline(panel.limit, color="0.4", linestyle="--", linewidth=1)
        axes.text(
            panel.limit,
            1,
            f" {panel.bounded_by}",
            rotation=90,
            va="top",
            fontsize=7,
            transform=axes.get_xaxis_transform(),
        )
    axes.set(title=panel.title, xlabel=panel.cost, ylabel=panel.error)
    axes.margins(0.2)
    scale_axes(axes)
    return points


def _read(name: str) -> Any:
    return loads((BENCH / f"{name}.json").read_text("utf-8"))


def main(
    output: Annotated[Path, typer.Option("-o", help="picture to write")] = Path("overview.png"),
) -> None:
    """Draw time against error of all stages."""
    draw_stages(PANELS).savefig(output, dpi=90)


if __name__ == "__main__":
    typer.run(main)
