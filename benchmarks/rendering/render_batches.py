"""Time and memory of batches of views, and time of what uses them: a training step, predictions.

    python -m benchmarks.rendering.render_batches --json docs/bench/render_batches.json

Each side and direction is measured in a process of its own, the smallest batch first. The map is a
texture of 1024 x 1024 px over 200 m, views show 100 m, and each has 20 cars with triangles. Memory
is the peak of the process beyond that before the first picture; with backward, gradients go to all
poses, sizes and colours. Each is on one thread, unless --threads says otherwise.

Uses: an optimiser step of ITRA as `geoaim train` takes it (32 segments), and `predict` as `geoaim
predict` does it, of the sample's traffic on its HD map, drawn at 0.1 m a pixel.
"""

import copy
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Annotated, Any

import torch
import typer
from torch import Tensor

from benchmarks.rendering.batches import make_scene
from benchmarks.results import (
    JsonFile,
    measure_peak_megabytes,
    print_rows,
    run_in_process,
    time_medians,
    write_rows,
)
from geoaim import rendering
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.prediction import ITRA, configure_fine_tuning, make_dataset, predict, read_pretrained
from geoaim.prediction.batches import Process, draw_batch
from geoaim.rendering import OrientedBoxes, Scene, make_ground, prefilter_ground, render
from geoaim.tracks.changes import resample_tracks
from geoaim.tracks.files import read_plain_tracks

BATCHES, SIDES = (1, 16, 64), (64, 256)
MAP_PX, MAP_M = 1024, 200.0
BATCH_SIZE, PREDICTED_S = 32, 4.0  # of `geoaim train` and `geoaim predict`


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


def measure(pixels: int, backward: bool, repeats: int, threads: int = 1) -> list[dict[str, float]]:
    """Measure processor time and memory of batches, from the smallest to the largest.

    Args:
        pixels: side of a view.
        backward: whether gradients are computed too.
        repeats: repetitions; the median counts.
        threads: threads of torch.

    Returns:
        For each of `BATCHES` milliseconds, and megabytes beyond those before the first picture.
    """
    torch.set_num_threads(threads)
    _render(8, 1, backward)()  # what only the first call does
    before, rows = measure_peak_megabytes(), []
    for views in BATCHES:
        [duration] = time_medians([_render(pixels, views, backward)], repeats, time.process_time)
        rows.append({"ms": 1e3 * duration, "megabytes": measure_peak_megabytes() - before})
    return rows


def make_uses() -> dict[str, Callable[[], Any]]:
    """Make functions that take a training step of ITRA, and that predict, on the sample."""
    uses: dict[str, Callable[[], Any]] = {}
    for kind in ("vehicle", "pedestrian"):
        model = read_pretrained(kind)
        scene = _make_sample_scene(model.config.dt)
        uses[f"predict, {kind}s"] = partial(_predict, model, scene)
        if kind == "vehicle":
            uses["training step, vehicles"] = _make_training(model, scene)
    return uses


def _make_sample_scene(dt: float) -> Scene:
    tracks = read_plain_tracks("samples/tracks.csv")
    hdmap = read_hdmap("samples/map.osm", tracks.world)
    return rendering.make_scene(draw_hdmap(hdmap, resolution=0.1), resample_tracks(tracks, 1 / dt))


def _predict(model: ITRA, scene: Scene) -> None:
    horizon = round(PREDICTED_S / model.config.dt)
    generator = torch.Generator().manual_seed(0)
    predict(model, scene, horizon=horizon, start=len(scene.times) // 2, generator=generator)


def _make_training(model: ITRA, scene: Scene) -> Callable[[], None]:
    """Make a function that takes one optimiser step, always on the same batch."""
    data, alone = make_dataset([scene], model.config), Process(0, 1, torch.device("cpu"))
    config = configure_fine_tuning(model.config.kind, steps=1, batch_size=BATCH_SIZE, seed=0)
    model = copy.deepcopy(model).train()
    optimiser = torch.optim.AdamW(model.parameters(), config.learning_rate)

    def step() -> None:
        losses = model(*draw_batch(config, data.train, data.ground, 0, alone))
        optimiser.zero_grad()
        (losses.nll + losses.kl).backward()
        optimiser.step()

    return step


def time_uses(repeats: int, threads: int = 1) -> list[dict[str, Any]]:
    """Time what uses views, processor time."""
    torch.set_num_threads(threads)
    uses = make_uses()
    durations = time_medians(list(uses.values()), repeats, time.process_time)
    return [{"use": name, "ms": 1e3 * one} for name, one in zip(uses, durations, strict=True)]


def main(
    json: JsonFile = None,
    threads: Annotated[int, typer.Option(help="threads of torch")] = 1,
    repeats: Annotated[int, typer.Option(help="of each timing; the median counts")] = 7,
) -> None:
    """Measure all batches; print a table and write JSON."""
    rows: list[dict[str, Any]] = []
    for pixels in SIDES:
        forward, both = (
            run_in_process(measure, pixels, way, repeats, threads) for way in (False, True)
        )
        for views, one, other in zip(BATCHES, forward, both, strict=True):
            row: dict[str, Any] = {"views": views, "side_px": pixels}
            row |= {f"forward, {unit}": value for unit, value in one.items()}
            rows.append(row | {f"with backward, {unit}": value for unit, value in other.items()})
    command = f"python -m benchmarks.rendering.render_batches --repeats {repeats}"
    print_rows(rows)
    uses = print_rows(time_uses(repeats, threads))
    write_rows(rows, json, command=command, torch=torch.__version__, uses=uses)


if __name__ == "__main__":
    typer.run(main)
