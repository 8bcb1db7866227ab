"""One's own place: what a training in ten minutes gives on the last 30 % of a recording.

    python -m benchmarks.prediction own_place

Headings and speeds of real recordings come from positions. Models give futures as `predict` does.
No choice has seen the places of `TEST`, though k729 was judged three times before, under earlier
rules by which futures follow the network of the place.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from benchmarks.prediction.averages import average_seeds
from benchmarks.prediction.real_places import KARLSRUHE, read_karlsruhe, read_zhengzhou
from benchmarks.prediction.results import (
    Metrics,
    Workspace,
    compute_differences,
    compute_seed_means,
    write_results,
)
from geoaim.base.defaults import SAMPLES
from geoaim.base.progress import Progress
from geoaim.cli.evaluate import train_on_beginning
from geoaim.cli.train import BATCH_SIZE, STEPS
from geoaim.prediction.baselines import BASELINES, Predictor, replay
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS, configure_fine_tuning
from geoaim.prediction.dataset import Dataset, cut_beginnings, hold_out_agents, make_dataset
from geoaim.prediction.evaluation import RECORDING, EvalConfig, judge
from geoaim.prediction.itra import ITRA
from geoaim.prediction.predict import draw_covering
from geoaim.prediction.segments import Segments
from geoaim.prediction.training import learn_place, train
from geoaim.rendering.scene import Scene
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules
from geoaim.tracks.formats.motion import derive_motion

FRACTION = 0.3  # at the end of each recording, on which it is judged
HORIZON = 40  # steps of 0.1 s
MOTION_WINDOW_S = 0.5
SEEDS = 3  # trainings, whose metrics are averaged


@dataclass(frozen=True, eq=False)
class _Recording:
    scenes: list[Scene]
    rules: RoadRules


def _read_junction(junction: str) -> _Recording:
    parts = list(read_karlsruhe(junction))
    moved = [
        replace(part, tracks=derive_motion(part.tracks, half_window=MOTION_WINDOW_S))
        for part in parts
    ]
    scenes = [part.make_scene(0.1) for part in moved]
    # one map, as `geoaim train` reads it: models of several places get no network of the place
    return _Recording([replace(scene, ground=scenes[0].ground) for scene in scenes], parts[0].rules)


def _read_zhengzhou(name: str) -> _Recording:
    return _Recording([read_zhengzhou(name).make_scene(0.1)], NO_ROAD_RULES)


VAL: dict[str, Callable[[], _Recording]] = {
    "Karlsruhe k733": lambda: _read_junction(KARLSRUHE[1]),
    "Zhengzhou 0592": lambda: _read_zhengzhou("DJI_0592"),
}
TEST: dict[str, Callable[[], _Recording]] = {
    "Karlsruhe k729": lambda: _read_junction(KARLSRUHE[0]),
    "Zhengzhou 0590": lambda: _read_zhengzhou("DJI_0590_0"),
}


def run(workspace: Workspace) -> list[Path]:
    """Train the vehicle model on recordings of places and judge it at their ends."""
    metrics: dict[str, Metrics] = {}
    minutes: dict[str, float] = {}
    means: dict[str, Sequence[Mapping[str, float]]] = {}
    differences: dict[str, Mapping[str, tuple[float, float]]] = {}
    for part, places in (("validation", VAL), ("test", TEST)):
        for place, read in places.items():
            recording = read()
            predictors, taken = _train(recording, workspace, place)
            options = EvalConfig(MAX_HISTORY_STEPS, SAMPLES)
            found = judge(
                predictors,
                recording.scenes,
                read_pretrained("vehicle").config,
                options,
                fraction=FRACTION,
                horizon=HORIZON,
                rules=recording.rules,
                progress=workspace.progress,
            )
            trained = [found.pop(f"{AFTER} {seed}") for seed in range(SEEDS)]
            found[AFTER] = average_seeds(trained)
            name = f"{part}, {place}"
            means[name] = compute_seed_means(trained)
            metrics |= {f"{name}, {method}": values for method, values in found.items()}
            minutes |= {f"{name}, {method}": value for method, value in taken.items()}
            if PLAIN in found:
                differences[name] = compute_differences(found[AFTER], found[PLAIN])
    settings = {"minutes": minutes, "trainings": means, "after minus plain network": differences}
    return write_results("own_place", metrics, settings, workspace.results)


def make_place_dataset(model: ITRA, scenes: Sequence[Scene], progress: Progress) -> Dataset:
    """Make the dataset of the beginnings of scenes, as `geoaim train` does."""
    dataset = make_dataset(scenes, model.config, val_fraction=FRACTION, progress=progress)
    learning, held_out = hold_out_agents(dataset.train)
    return replace(dataset, train=learning, val=held_out)


def train_place(
    model: ITRA, scenes: Sequence[Scene], folder: Path, progress: Progress, *, seed: int = 0
) -> ITRA:
    """Fine-tune a model on a place and give it a network of the place, as `geoaim train` does."""
    dataset = make_place_dataset(model, scenes, progress)
    config = configure_fine_tuning("vehicle", steps=STEPS, batch_size=BATCH_SIZE, seed=seed)
    trained = train(model, config, dataset, folder, progress=progress)
    return learn_place(trained, dataset, _cut_whole(model, scenes))


def _cut_whole(model: ITRA, scenes: Sequence[Scene]) -> Segments | None:
    return cut_beginnings(scenes, model.config, FRACTION, MAX_HISTORY_STEPS + HORIZON)


BEFORE, PLACE, AFTER, PLAIN = "before", "network of the place", "after", "plain network"


def _train(
    recording: _Recording, workspace: Workspace, place: str
) -> tuple[dict[str, Predictor], dict[str, float]]:
    """Train as `geoaim train` does; predictors by name, and minutes of the trainings."""
    model = read_pretrained("vehicle")
    began = time.perf_counter()
    dataset = make_place_dataset(model, recording.scenes, workspace.progress)
    known = learn_place(model, dataset, _cut_whole(model, recording.scenes))
    seconds = time.perf_counter() - began
    predictors: dict[str, Predictor] = {
        BEFORE: partial(draw_covering, model),
        PLACE: partial(draw_covering, known),
    }
    for seed in range(SEEDS):
        folder = workspace.models / f"own_place_{place.replace(' ', '_')}_{seed}"
        trained = train_place(model, recording.scenes, folder, workspace.progress, seed=seed)
        predictors[f"{AFTER} {seed}"] = partial(draw_covering, trained)
    taken = (time.perf_counter() - began - seconds) / SEEDS + seconds
    minutes = {PLACE: seconds / 60, AFTER: taken / 60}
    predictors |= BASELINES
    plain = train_on_beginning(model, recording.scenes, FRACTION)
    if plain is not None:
        predictors[PLAIN] = plain.sample
    return {**predictors, RECORDING: replay}, minutes
