"""How fast ITRA learns and samples, and how much of it is drawing views.

    python -m geoaim.bench.prediction --json docs/bench/prediction.json

Segments are of a made junction. Sampling is of 6 futures of 20 vehicles over 40 steps, 4 s, after
10 known ones; drawing is the part of a training step that `egos_see` takes, forward and back.
"""

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import torch
import typer

from geoaim.aim import AIM
from geoaim.bench.report import format_table, time_medians, write_rows
from geoaim.prediction.checkpoints import read_model, shipped
from geoaim.prediction.itra import ITRA, Config
from geoaim.prediction.lessons import STEPS
from geoaim.prediction.predict import OBSERVED
from geoaim.prediction.segments import Segments, cut_segments, pick
from geoaim.prediction.views import egos_of, egos_see
from geoaim.simulation.ground import Ground, fit_ground
from geoaim.simulation.scene import Scene, make_scene
from geoaim.synthetic import draw_place, make_sample, tracks_of, world_from_image
from geoaim.track_changes import resample_tracks

AGENTS, SAMPLES, BATCH = 20, 6, 48
REPEATS = 25
RESOLUTION = 0.2


def made_scene(config: Config) -> Scene:
    """The traffic of a made junction."""
    sample = make_sample(1, minutes=3.0, video=None, resolution=RESOLUTION)
    image = draw_place(sample.place, resolution=RESOLUTION)
    place = world_from_image(sample.place, RESOLUTION)
    aim = AIM.from_image(image, place, sample.place.world, "drawn")
    return make_scene(aim, resample_tracks(tracks_of(sample), 1 / config.seconds))


def together(segments: Segments) -> Segments:
    """One segment with so many who are moved: egos of others, all at one place and time."""
    some = pick(segments, slice(0, AGENTS))
    states = some.states[:, :, 0].transpose(0, 1)[None]
    return replace(
        pick(some, slice(0, 1)),
        states=states,
        present=torch.ones(states.shape[:3], dtype=torch.bool),
        sizes=some.sizes[:, 0][None],
        planes=some.planes[:, 0][None],
        controlled=torch.ones(1, AGENTS, dtype=torch.bool),
    )


def row(kind: str, threads: int) -> dict[str, Any]:
    """Figures of one of the shipped models."""
    torch.set_num_threads(threads)
    model = read_model(shipped(kind)).train()
    config = model.config
    scene = made_scene(config)
    ground = fit_ground(scene.ground, config.resolution)
    segments = cut_segments(scene, kind, steps=STEPS[kind], stride=10)
    batch = pick(segments, slice(0, None, max(1, len(segments) // BATCH)))
    batch = pick(batch, slice(0, BATCH))
    generator = torch.Generator().manual_seed(0)

    def learn() -> None:
        losses = model(batch, ground, OBSERVED, generator)
        (losses.fit + losses.divergence).backward()

    looks = [k for k in range(STEPS[kind] - 1) if (k - OBSERVED + 1) % config.every == 0]

    def draw() -> None:
        for number in looks:
            states = batch.states[:, number].clone().requires_grad_(number >= OBSERVED)
            views = egos_see(config.view, ground, batch, egos_of(batch), states, number)
            if views.requires_grad:
                views.sum().backward()  # type: ignore[no-untyped-call]

    step, drawing = time_medians([learn, draw], REPEATS)
    found = {
        "model": kind,
        "threads": threads,
        "segments a second": BATCH / step,
        "share of drawing": drawing / step,
        "ms of a view": 1000 * drawing / len(looks) / BATCH,
    }
    if kind == "vehicle":
        longer = cut_segments(scene, kind, steps=OBSERVED + STEPS[kind], stride=10)
        found["s to sample 4 s"] = _sampling(model.eval(), together(longer), ground)
    return found


def _sampling(model: ITRA, segments: Segments, ground: Ground) -> float:
    generator = torch.Generator().manual_seed(0)

    def sample() -> None:
        model.sample(segments, ground, observed=OBSERVED, samples=SAMPLES, generator=generator)

    return time_medians([sample], REPEATS)[0]


def main(json: Annotated[Path | None, typer.Option(help="file to write")] = None) -> None:
    """Print the table."""
    start = time.perf_counter()
    rows = [row(kind, threads) for threads in (1, 2) for kind in ("vehicle", "pedestrian")]
    print(format_table(rows))
    write_rows(rows, json, command="python -m geoaim.bench.prediction", torch=torch.__version__)
    print(f"{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    typer.run(main)
