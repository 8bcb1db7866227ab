"""The command that trains a prediction model."""

import csv
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from geoaim.base.defaults import SAMPLES
from geoaim.base.errors import TracksError, warn
from geoaim.base.progress import Progress
from geoaim.cli import options
from geoaim.cli.console import console, report_errors, show_progress
from geoaim.cli.evaluate import Result, print_result, train_on_beginning
from geoaim.cli.inputs import SceneFiles, SceneSource, get_horizon, load_model, take_scene_files
from geoaim.cli.outputs import check_output

if TYPE_CHECKING:
    from geoaim.prediction.dataset import Dataset
    from geoaim.prediction.itra import ITRA
    from geoaim.rendering.scene import Scene

STEPS, BATCH_SIZE = 100, 32  # defaults
CHECKPOINT_STEPS = 50  # steps from one checkpoint to the next
TIMED_STEPS = 10  # after which it is said how long the others take


@take_scene_files
def train(
    aim: Annotated[
        Path,
        typer.Argument(
            help="AIM, with --tracks; or a table of recordings, .csv, with the columns aim, "
            "tracks and, where needed, tracks_world, lights, hdmap, ...; or a folder of catalog"
        ),
    ],
    *,
    output: Annotated[Path, options.output("folder for model.pt, log.csv and curves.png")],
    tracks: options.SceneTracks = None,
    kind: options.Kind = "vehicles",
    weights: options.WeightsFile = None,
    scratch: Annotated[
        bool,
        typer.Option(
            "--scratch",
            help="start from random weights, with the configuration of --weights or the default",
        ),
    ] = False,
    steps: Annotated[int, typer.Option(help="optimiser steps", min=1)] = STEPS,
    batch_size: Annotated[int, typer.Option(help="segments in a batch", min=1)] = BATCH_SIZE,
    segment_duration: Annotated[
        float | None,
        typer.Option(
            help="seconds of a training segment; 4 of vehicles, 12 of pedestrians, 8 of cyclists"
        ),
    ] = None,
    val_fraction: Annotated[
        float,
        typer.Option(
            help="fraction at the end of the tracks on which the result is judged",
            min=0.01,
            max=0.9,
        ),
    ] = 0.1,
    seed: options.Seed = 0,
    files: SceneFiles,
) -> None:
    """Train a prediction model on your map: fine-tune a trained model, or start from scratch.

    One of seven agents is held out to choose the step that is kept; a training that makes nothing
    better says so. Then a network of this place is trained in seconds, and the model before and
    after is judged at the end of the tracks, beside baselines. An interrupted training resumes when
    the same command is called again. Use the model with --weights FOLDER/model.pt in predict and
    evaluate; give evaluate the same --val-fraction.

    Example: geoaim train map.tif --tracks samples/tracks.csv --val-fraction 0.4 -o model
    """
    from geoaim.prediction.checkpoints import write_model
    from geoaim.prediction.config import (
        MAX_HISTORY_STEPS,
        configure_fine_tuning,
        configure_training,
    )
    from geoaim.prediction.dataset import cut_beginnings
    from geoaim.prediction.report import plot_training
    from geoaim.prediction.training import learn_place
    from geoaim.prediction.training import train as train_model

    judged: Result | None = None
    with show_progress() as progress, report_errors():
        check_output(output / "model.pt", inputs=[weights])
        source = SceneSource(aim, tracks, **files)
        model = _init_model(weights, kind, seed) if scratch else load_model(weights, kind)
        scenes, dataset = _make_dataset(source, model, val_fraction, segment_duration, progress)
        configure = configure_training if scratch else configure_fine_tuning
        config = configure(model.config.kind, steps=steps, batch_size=batch_size, seed=seed)
        config = replace(config, checkpoint_interval=CHECKPOINT_STEPS)
        try:
            report = _announce_duration(progress)
            trained = train_model(model, config, dataset, output, progress=report)
        except (KeyboardInterrupt, SystemExit):
            console.print(_describe_checkpoint(output))
            raise
        plot_training(output / "log.csv", output / "curves.png")
        steps_seen = MAX_HISTORY_STEPS + get_horizon(trained)
        whole = cut_beginnings(scenes, trained.config, val_fraction, steps_seen)
        placed = learn_place(trained, dataset, whole)
        if placed.own_place is not None:
            write_model(placed, output / "model.pt")
        before = None if scratch else model
        try:
            judged = _judge(before, placed, scenes, val_fraction, progress)
        except TracksError as error:  # the model is trained, and stays
            warn(f"the model is not judged: {error}")
    console.print(
        f"{output / 'model.pt'}: trained on {len(dataset.train)} segments, chosen by "
        f"{len(dataset.val)} of other agents: "
        f"{_summarize_log(output / 'log.csv')}; see {output / 'curves.png'}"
    )
    if judged is not None:
        console.print(f"Judged on the last {100 * val_fraction:g} % of the tracks:")
        print_result(judged, SAMPLES)


def _make_dataset(
    source: SceneSource,
    model: "ITRA",
    val_fraction: float,
    segment_duration: float | None,
    progress: Progress,
) -> "tuple[list[Scene], Dataset]":
    """Read one or several recordings; segments to train on, and those of held-out agents."""
    from geoaim.cli.inputs import lists_recordings, read_scene_sources, read_scenes
    from geoaim.prediction.dataset import hold_out_agents, make_dataset

    sources, dt = [source], model.config.dt
    if lists_recordings(source.aim):
        if any(value for name, value in vars(source).items() if name != "aim"):
            raise ValueError(
                f"{source.aim} names the files of each recording; leave their options out"
            )
        sources = read_scene_sources(source.aim)
    scenes = read_scenes(sources, 1 / dt, progress, skip=source.aim.is_dir())
    dataset = make_dataset(
        scenes,
        model.config,
        val_fraction=val_fraction,
        segment_steps=None if segment_duration is None else round(segment_duration / dt),
        progress=progress,
    )
    train, val = hold_out_agents(dataset.train)
    return scenes, replace(dataset, train=train, val=val)


def _judge(
    before: "ITRA | None", after: "ITRA", scenes: "list[Scene]", fraction: float, progress: Progress
) -> Result:
    """Judge a model before and after its training beside baselines, at the end of scenes."""
    from geoaim.prediction.baselines import BASELINES, Predictor
    from geoaim.prediction.config import MAX_HISTORY_STEPS
    from geoaim.prediction.evaluation import EvalConfig, judge
    from geoaim.prediction.predict import draw_covering

    models = {"after": after} if before is None else {"before": before, "after": after}
    predictors: dict[str, Predictor] = {
        name: partial(draw_covering, model) for name, model in models.items()
    }
    predictors |= BASELINES
    plain = train_on_beginning(after, scenes, fraction)
    if plain is not None:
        predictors["plain network"] = plain.sample
    options, horizon = EvalConfig(MAX_HISTORY_STEPS, SAMPLES), get_horizon(after)
    given = predictors, scenes, after.config, options
    metrics = judge(*given, fraction=fraction, horizon=horizon, progress=progress)
    count = len(metrics["after"]["minADE"].sums)
    return metrics, count, f"{horizon * after.config.dt:g} s"


def _announce_duration(progress: Progress) -> Progress:
    """Report progress, and once print about how long the steps of a training take."""
    started: list[tuple[float, float]] = []

    def report(stage: str, done: float, total: float | None) -> None:
        progress(stage, done, total)
        if stage != "train" or total is None:
            return
        started.append((done, time.perf_counter()))
        if len(started) == TIMED_STEPS + 1:
            (first, began), (last, now) = started[0], started[-1]
            minutes = (total - done) * (now - began) / (last - first) / 60
            text = f"about {minutes:.0f} minutes" if minutes >= 1.5 else "a minute or two"
            console.print(f"{total - done:.0f} more steps, validated on the way: {text}")

    return report


def _init_model(weights: Path | None, kind: options.AgentKind, seed: int) -> "ITRA":
    """Make a model with random weights."""
    from geoaim.prediction.config import DEFAULT_CONFIGS
    from geoaim.prediction.training import init_model

    default = DEFAULT_CONFIGS[kind.removesuffix("s")]
    config = default if weights is None else load_model(weights, kind).config
    return init_model(config, seed=seed)


def _describe_checkpoint(folder: Path) -> str:
    if not (folder / "log.csv").exists():
        return f"{folder} has no checkpoint yet; the same command starts again"
    step = (folder / "log.csv").read_text(encoding="utf-8").splitlines()[-1].split(",")[0]
    return f"{folder / 'checkpoint.pt'} is kept; the same command goes on after step {step}"


def _summarize_log(log: Path) -> str:
    """Compare the best validated step of a training log with the start, or with the first one."""
    from geoaim.prediction.training import find_best_step

    table = csv.DictReader(log.read_text(encoding="utf-8").splitlines())
    rows = [{name: float(value) for name, value in row.items()} for row in table]
    best = find_best_step(rows)
    first, last = rows[0], rows[-1]
    if best == 0:
        return (
            f"no better than before: minADE {first['minADE']:.2f} m before, {last['minADE']:.2f} m "
            f"after step {last['step']:.0f}; model.pt has the weights that training began with"
        )
    chosen = next(row for row in rows if row["step"] == best)
    before = "before" if first["step"] == 0 else f"after step {first['step']:.0f}"
    text = f"minADE {first['minADE']:.2f} m {before}, {chosen['minADE']:.2f} m after step {best}"
    return text if best == last["step"] else f"{text}, which is kept as the best"
