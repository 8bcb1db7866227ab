"""Time and memory of batches of views, forward and with backward, on one thread.

    python -m benchmarks.rendering.render_batches --json docs/bench/render_batches.json

Each side and direction is measured in a process of its own, the smallest batch first. The map is a
texture of 1024 x 1024 px over 200 m, views show 100 m, and each has 20 cars with triangles. Memory
is the peak of the process beyond that before the first picture; with backward, gradients go to all
poses, sizes and colours.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any

import torch
import typer
from torch import Tensor

from benchmarks.rendering.batches import make_scene
from geoaim.mapping.bench.report import (
    JsonFile,
    measure_peak_megabytes,
    print_rows,
    run_in_process,
    time_medians,
    write_rows,
)
from geoaim.simulation import OrientedBoxes, make_ground, prefilter_ground, render

BATCHES, SIDES = (1, 16, 64), (64, 256)
MAP_PX, MAP_M = 1024, 200.0


def _render(pixels: int, views: int, backward: bool) -> Callable[[], Tensor]:
    """Make a function that renders a batch, and with `backward` computes all gradients."""
    view, cameras, boxes = make_scene(pixels, views)
    scale = MAP_PX / MAP_M
    matrix = torch.tensor([[scale, 0, MAP_PX / 2], [0, -scale, MAP_PX / 2]])
    image = torch.rand(3, MAP_PX, MAP_PX, generator=torch.Generator().manual_seed(0))
    ground = prefilter_ground(make_ground(image, matrix), view.resolution)

    def draw(boxes: OrientedBoxes) -> Tensor:
        return render(view, cameras, ground, [boxes])

    def draw_and_return() -> Tensor:
        names = ("poses", "sizes", "colours")
        given = replace(
            boxes, **{name: getattr(boxes, name).clone().requires_grad_() for name in names}
        )
        picture = draw(given)
        picture.sum().backward()  # type: ignore[no-untyped-call]
        return picture

    return draw_and_return if backward else lambda: draw(boxes)


def measure(pixels: int, backward: bool, repeats: int) -> list[dict[str, float]]:
    """Measure processor time and memory of batches, from the smallest to the largest.

    Args:
        pixels: side of a view.
        backward: whether gradients are computed too.
        repeats: repetitions; the median counts.

    Returns:
        For each of `BATCHES` milliseconds, and megabytes beyond those before the first picture.
    """
    torch.set_num_threads(1)
    _render(8, 1, backward)()  # compiles
    before, rows = measure_peak_megabytes(), []
    for views in BATCHES:
        [duration] = time_medians([_render(pixels, views, backward)], repeats, time.process_time)
        rows.append({"ms": 1e3 * duration, "megabytes": measure_peak_megabytes() - before})
    return rows


def main(
    json: JsonFile = None,
    repeats: Annotated[int, typer.Option(help="of each timing; the median counts")] = 7,
) -> None:
    """Measure all batches; print a table and write JSON."""
    rows: list[dict[str, Any]] = []
    for pixels in SIDES:
        forward, both = (run_in_process(measure, pixels, way, repeats) for way in (False, True))
        for views, one, other in zip(BATCHES, forward, both, strict=True):
            row: dict[str, Any] = {"views": views, "side_px": pixels}
            row |= {f"forward, {unit}": value for unit, value in one.items()}
            rows.append(row | {f"with backward, {unit}": value for unit, value in other.items()})
    command = f"python -m benchmarks.rendering.render_batches --repeats {repeats}"
    write_rows(print_rows(rows), json, command=command, torch=torch.__version__)


if __name__ == "__main__":
    typer.run(main)
