"""Speed against exactness: ways to compute how much of a pixel a box covers.

    python -m benchmarks.rendering.exactness --json docs/bench/exactness.json \\
        --chart docs/images/exactness.png

Cars of 4.5 x 1.9 m at all headings in views of 100 m; each pixel in a square window around a car is
a case. Errors are against exact areas: of shares, in grey levels, over the pixels of a whole view
with 20 cars, and over those that an edge crosses. Gradients by the place of the car: what is left
of them, 0 where a way has none, and their mean error.
"""

from collections.abc import Callable
from functools import partial
from time import process_time
from typing import Any

import numpy as np
import torch
import typer
from jaxtyping import Float
from numpy import ndarray as Array
from torch import Tensor

from benchmarks.charts import draw_fronts
from benchmarks.rendering.batches import AGENTS, CAR_SIZE_M, VIEW_SIDE_M
from benchmarks.results import ChartFile, JsonFile, Row, print_rows, time_medians, write_rows
from geoaim.rendering.coverage import measure_overlap

CARS = 400
STEP_PX = 1e-3  # of differences
Way = Callable[[Float[Array, "2 m"], Float[Array, "m"], Float[Array, "2"]], Float[Array, "m"]]


def compute_pixel_coverage(corners: Float[Tensor, "n K 2"]) -> Float[Tensor, "n"]:
    """Compute the area that polygons share with the unit square, by Green's theorem.

    It is the integral of x dy around each polygon, with both clamped to [0, 1].

    >>> square = torch.tensor([[[0.5, 0.5], [9.0, 0.5], [9.0, 9.0], [0.5, 9.0]]])
    >>> compute_pixel_coverage(square).tolist()
    [0.25]
    """
    x, y = corners.unbind(-1)
    next_y = y.roll(-1, 1)
    run, rise = x.roll(-1, 1) - x, next_y - y
    slope = run / torch.where(rise == 0, 1.0, rise)
    # ends of the part of the edge in the square's rows
    start, end = y.clamp(0, 1), next_y.clamp(0, 1)
    first_x = x + (start - y) * slope
    last_x = x + (end - y) * slope
    width = last_x - first_x
    vertical = width.abs() < 1e-3  # pixels
    mean_x = _integrate_within_limits(last_x) - _integrate_within_limits(first_x)
    mean_x = mean_x / torch.where(vertical, 1.0, width)
    mean_x = torch.where(vertical, ((first_x + last_x) / 2).clamp(0, 1), mean_x)
    return ((end - start) * mean_x).sum(1)


def _integrate_within_limits(x: Tensor) -> Tensor:
    """Integrate from 0 to x its value clamped to [0, 1]."""
    clamped = x.clamp(0, 1)
    return clamped * (x - clamped / 2)


def _cover_exactly(place: Array, turn: Array, half: Array) -> Array:
    cosine, sine = np.cos(turn), np.sin(turn)
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * half
    u = 0.5 - place[0][:, None] + corners[:, 0] * cosine[:, None] - corners[:, 1] * sine[:, None]
    v = 0.5 - place[1][:, None] + corners[:, 0] * sine[:, None] + corners[:, 1] * cosine[:, None]
    return compute_pixel_coverage(torch.from_numpy(np.stack([u, v], axis=-1))).abs().numpy()


def _turn(place: Array, turn: Array) -> Array:
    cosine, sine = np.cos(turn), np.sin(turn)
    return np.array([cosine * place[0] + sine * place[1], cosine * place[1] - sine * place[0]])


def _cover_by_clamps(place: Array, turn: Array, half: Array) -> Array:
    shares: Array = measure_overlap(_turn(place, turn), half[:, None])
    return np.asarray(shares[0] * shares[1])


def _cover_by_wide_clamps(place: Array, turn: Array, half: Array) -> Array:
    wide = np.abs(np.cos(turn)) + np.abs(np.sin(turn))  # a pixel's extent along the box's axes
    shares: Array = measure_overlap(_turn(place, turn) / wide, half[:, None] / wide)
    return np.asarray(shares[0] * shares[1])


def _sample(count: int) -> Way:
    offsets = (np.arange(count) + 0.5) / count - 0.5

    def cover(place: Array, turn: Array, half: Array) -> Array:
        total = np.zeros(place.shape[1])
        for u in offsets:
            for v in offsets:
                x = np.abs(_turn(place + np.array([[u], [v]]), turn))
                total += (x[0] < half[0]) & (x[1] < half[1])
        return total / count**2

    return cover


WAYS: dict[str, Way] = {
    "exact areas": _cover_exactly,
    "two clamps": _cover_by_clamps,
    "two clamps, as wide as the pixel": _cover_by_wide_clamps,
    "4 x 4 samples": _sample(4),
    "2 x 2 samples": _sample(2),
    "hard edges": _sample(1),
}


def compare_ways(pixels: int, repeats: int) -> list[Row]:
    """Measure time and errors of each way in views of so many pixels a side."""
    generator = np.random.default_rng(0)
    half = np.array(CAR_SIZE_M) / 2 * pixels / VIEW_SIDE_M
    side = int(2 * np.hypot(*half)) + 3
    v, u = np.mgrid[:side, :side].reshape(2, 1, -1) - (side - 1) / 2
    shift = generator.random((2, CARS, 1)) - 0.5
    place = (np.array([u, v]) + shift).reshape(2, -1)
    turn = np.repeat(generator.random(CARS) * 2 * np.pi, side**2)
    exact = _cover_exactly(place, turn, half)
    edge = (exact > 0) & (exact < 1)
    slope = _differentiate(_cover_exactly, place, turn, half)
    durations = time_medians(
        [partial(way, place, turn, half) for way in WAYS.values()], repeats, process_time
    )
    rows: list[Row] = []
    for (name, way), duration in zip(WAYS.items(), durations, strict=True):
        error = 255 * np.abs(way(place, turn, half) - exact)
        own = _differentiate(way, place, turn, half)
        rows.append(
            {
                "pixels": pixels,
                "way": name,
                "ns per pixel of a box": 1e9 * duration / len(turn),
                "mean error of a view": float(error.sum() / CARS * AGENTS / pixels**2),
                "mean error at edges": float(error[edge].mean()),
                "largest error": float(error.max()),
                "error of gradients, share": float(np.abs(own - slope).sum() / np.abs(slope).sum()),
            }
        )
    return rows


def _differentiate(way: Way, place: Array, turn: Array, half: Array) -> Array:
    step = np.array([[STEP_PX], [0.0]])
    return (way(place + step, turn, half) - way(place - step, turn, half)) / (2 * STEP_PX)


def main(json: JsonFile = None, chart: ChartFile = None, repeats: int = 9) -> None:
    """Compare ways to cover pixels; print a table, write JSON and a chart."""
    torch.set_num_threads(1)
    rows = print_rows(row for pixels in (64, 256) for row in compare_ways(pixels, repeats))
    panels: dict[str, Any] = {
        f"views of {pixels} px": [
            {"method": row["way"], "error": max(1e-4, float(row["mean error at edges"]))}
            | {"time": row["ns per pixel of a box"]}
            for row in rows
            if row["pixels"] == pixels
        ]
        for pixels in (64, 256)
    }
    labels = ("ns for each pixel of a box", "error at edges, grey levels")
    if chart:
        figure = draw_fronts(panels, cost="time", error="error", labels=labels)
        figure.savefig(chart, dpi=110)
    command = f"python -m benchmarks.rendering.exactness --repeats {repeats}"
    write_rows(rows, json, command=command)


if __name__ == "__main__":
    typer.run(main)
