"""What models learn from tracks that were found without a detector, against true tracks.

    python -m benchmarks.tracking.models_without_detector \
        --json docs/bench/models_without_detector.json

Drawn places are filmed for two minutes, and the maps built of the videos. The plain network, and
with --fine-tune the vehicle model as `geoaim train` trains it, learn from the beginning: once from
the tracks that `track_video` finds without a detector, once from the true tracks of the vehicles
in view. Both are judged on the true tracks of the end.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import torch
import typer

from benchmarks.prediction.own_place import FRACTION, train_place
from benchmarks.results import JsonFile, print_rows, write_rows
from benchmarks.tracking.benchmark import KINDS, TEST_SEED, VALIDATION_SEED
from benchmarks.tracking.filmed_cases import FilmedCase, film_drawn
from geoaim.base.defaults import SAMPLES
from geoaim.base.geometry import transform_points
from geoaim.base.progress import no_progress
from geoaim.cli.evaluate import train_on_beginning
from geoaim.cli.inputs import get_horizon
from geoaim.prediction.baselines import BASELINES, Predictor
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS
from geoaim.prediction.evaluation import EvalConfig, judge
from geoaim.prediction.metrics import summarise
from geoaim.rendering.scene import make_scene
from geoaim.tracking.pipeline import track_video
from geoaim.tracks.agent_types import select_group
from geoaim.tracks.changes import resample_tracks
from geoaim.tracks.tracks import Tracks

PLACES = KINDS[:2]
SECONDS, FRAME_RATE = 120.0, 10.0
METRICS = ("minADE", "minFDE")


def measure_case(case: FilmedCase, folder: Path | None) -> dict[str, Any]:
    """Measure models trained on tracks found without a detector, and on true ones."""
    model = read_pretrained("vehicle")
    tracks = {
        "found": track_video(case.video, case.aim, progress=no_progress),
        "true": keep_vehicles_in_view(case),
    }
    scenes = {
        name: make_scene(case.aim, resample_tracks(known, 1 / model.config.dt))
        for name, known in tracks.items()
    }
    predictors: dict[str, Predictor] = {"constant velocity": BASELINES["constant velocity"]}
    for name, scene in scenes.items():
        plain = train_on_beginning(model, [scene], FRACTION)
        assert plain is not None
        predictors[f"plain network, {name} tracks"] = plain.sample
        if folder is not None:
            tuned = train_place(model, [scene], folder / f"{case.name} {name}", no_progress)
            predictors[f"ITRA, {name} tracks"] = tuned.sample
    if folder is not None:
        predictors["ITRA before"] = model.sample
    metrics = judge(
        predictors,
        [scenes["true"]],
        model.config,
        EvalConfig(MAX_HISTORY_STEPS, SAMPLES),
        fraction=FRACTION,
        horizon=get_horizon(model),
        progress=no_progress,
    )
    row: dict[str, Any] = {"video": case.name}
    for name, known in tracks.items():
        row[f"{name} vehicles"] = int(select_group(known.types, "vehicle").sum())
    for name, found in metrics.items():
        means = summarise(found)
        row |= {f"{name}: {metric}": means[metric]["mean"] for metric in METRICS}
    for name in ("plain network", "ITRA")[: 1 if folder is None else 2]:
        found, true = (row[f"{name}, {kind} tracks: minADE"] for kind in ("found", "true"))
        row[f"{name}: found / true"] = found / true
    return row


def keep_vehicles_in_view(case: FilmedCase) -> Tracks:
    """The true tracks of vehicles while their middles are inside the frames."""
    truth = case.truth
    middles = transform_points(case.frame_from_world, truth.states[..., :2].swapaxes(0, 1))
    inside = ((middles > 0) & (middles < case.size[::-1])).all(axis=2).T
    vehicles = select_group(truth.types, "vehicle")
    return replace(truth, present=truth.present & inside & vehicles[:, None])


def make_cases(seed: int, folder: Path) -> Iterator[FilmedCase]:
    """Film the places."""
    for number, kind in enumerate(PLACES):
        yield film_drawn(kind, seed + number, folder, seconds=SECONDS, frame_rate=FRAME_RATE)


def main(
    json: JsonFile = None,
    validation: Annotated[bool, typer.Option(help="the validation places")] = False,
    fine_tune: Annotated[bool, typer.Option(help="also ITRA, for ten minutes more each")] = False,
) -> None:
    """Measure models that learn from tracks found without a detector."""
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cases = make_cases(VALIDATION_SEED if validation else TEST_SEED, folder)
        rows = print_rows(measure_case(case, folder if fine_tune else None) for case in cases)
    settings = {"seconds": SECONDS, "frame_rate": FRAME_RATE, "judged": FRACTION}
    command = "python -m benchmarks.tracking.models_without_detector --fine-tune"
    write_rows(rows, json, command=command, **settings)


if __name__ == "__main__":
    typer.run(main)
