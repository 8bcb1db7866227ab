"""Speed of ITRA: training, sampling, and rendering as a part of training.

    python -m geoaim.bench.prediction --json docs/bench/prediction.json

Segments are of a synthetic junction. Sampling is of 6 futures of 20 vehicles over 40 steps (4 s)
after 10 observed ones. Rendering is `render_observation` in a training step, forward and backward.
"""

from dataclasses import replace
from typing import Any

import torch
import typer

from geoaim.aim import AIM
from geoaim.bench.report import JsonFile, print_rows, time_medians, write_rows
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS, SEGMENT_STEPS, Config
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.itra import ITRA
from geoaim.prediction.observation import index_controlled, render_observation
from geoaim.prediction.segments import Segments, pick
from geoaim.simulation.ground import Ground, prefilter_ground
from geoaim.simulation.scene import Scene, make_scene
from geoaim.synthetic import draw_place, make_sample, tracks_of, world_from_image
from geoaim.track_changes import resample_tracks

AGENTS, SAMPLES, BATCH_SIZE = 20, 6, 48
REPEATS = 25
RESOLUTION = 0.2  # metres per pixel


def make_junction_scene(config: Config) -> Scene:
    """Make the scene of a synthetic junction's traffic."""
    sample = make_sample(1, minutes=3.0, video=None, resolution=RESOLUTION)
    image = draw_place(sample.place, resolution=RESOLUTION)
    matrix = world_from_image(sample.place, RESOLUTION)
    aim = AIM.from_image(image, matrix, sample.place.world, "drawn")
    return make_scene(aim, resample_tracks(tracks_of(sample), 1 / config.dt))


def join_agents(segments: Segments) -> Segments:
    """Join the controlled agents of several segments into one segment."""
    some = pick(segments, slice(0, AGENTS))
    states = some.states[:, :, 0].transpose(0, 1)[None]
    return replace(
        pick(some, slice(0, 1)),
        states=states,
        present=torch.ones(states.shape[:3], dtype=torch.bool),
        sizes=some.sizes[:, 0][None],
        layers=some.layers[:, 0][None],
        controlled=torch.ones(1, AGENTS, dtype=torch.bool),
    )


def measure_model(kind: str, threads: int) -> dict[str, Any]:
    """Measure one of the pretrained models."""
    torch.set_num_threads(threads)
    model = read_pretrained(kind).train()
    scene = make_junction_scene(model.config)
    ground = prefilter_ground(scene.ground, model.config.resolution)
    segments = cut_segments(scene, kind, steps=SEGMENT_STEPS[kind], stride=10)
    batch = pick(segments, slice(0, None, max(1, len(segments) // BATCH_SIZE)))
    batch = pick(batch, slice(0, BATCH_SIZE))
    generator = torch.Generator().manual_seed(0)
    encoded_steps = [
        step
        for step in range(SEGMENT_STEPS[kind] - 1)
        if (step - MAX_HISTORY_STEPS + 1) % model.config.view_stride == 0
    ]

    def train() -> None:
        losses = model(batch, ground, MAX_HISTORY_STEPS, generator)
        (losses.nll + losses.kl).backward()

    def render() -> None:
        controlled = index_controlled(batch)
        for step in encoded_steps:
            states = batch.states[:, step].clone().requires_grad_(step >= MAX_HISTORY_STEPS)
            view = model.config.view
            views = render_observation(view, ground, batch, controlled, states, step)
            if views.requires_grad:
                views.sum().backward()  # type: ignore[no-untyped-call]

    step_time, render_time = time_medians([train, render], REPEATS)
    row = {
        "model": kind,
        "threads": threads,
        "segments a second": BATCH_SIZE / step_time,
        "share of rendering": render_time / step_time,
        "ms of a view": 1000 * render_time / len(encoded_steps) / BATCH_SIZE,
    }
    if kind == "vehicle":
        steps = MAX_HISTORY_STEPS + SEGMENT_STEPS[kind]
        longer = cut_segments(scene, kind, steps=steps, stride=10)
        row["s to sample 4 s"] = _time_sampling(model.eval(), join_agents(longer), ground)
    return row


def _time_sampling(model: ITRA, segments: Segments, ground: Ground) -> float:
    generator = torch.Generator().manual_seed(0)

    def sample() -> None:
        model.sample(
            segments, ground, history=MAX_HISTORY_STEPS, samples=SAMPLES, generator=generator
        )

    return time_medians([sample], REPEATS)[0]


def main(json: JsonFile = None) -> None:
    """Measure both pretrained models, on one thread and on two."""
    kinds = ("vehicle", "pedestrian")
    rows = print_rows(measure_model(kind, threads) for threads in (1, 2) for kind in kinds)
    write_rows(rows, json, command="python -m geoaim.bench.prediction", torch=torch.__version__)


if __name__ == "__main__":
    typer.run(main)
