"""The command that trains a prediction model."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from geoaim.cli import options
from geoaim.cli.console import console, report_errors, show_progress
from geoaim.cli.inputs import SceneSource, load_model, read_scene
from geoaim.cli.outputs import check_output

if TYPE_CHECKING:
    from geoaim.prediction.itra import ITRA

CHECKPOINT_STEPS = 50  # from one checkpoint to the next


def train(
    aim: options.AimFile,
    tracks: options.TracksFile,
    output: Annotated[Path, options.output("folder for model.pt, log.csv and curves.png")],
    kind: options.Kind = "vehicles",
    weights: options.WeightsFile = None,
    scratch: Annotated[
        bool,
        typer.Option(
            "--scratch",
            help="start from random weights, with the configuration of --weights or the default",
        ),
    ] = False,
    steps: Annotated[int, typer.Option(help="optimiser steps", min=1)] = 200,
    batch_size: Annotated[int, typer.Option(help="segments in a batch", min=1)] = 32,
    val_fraction: Annotated[
        float,
        typer.Option(help="fraction at the end of the tracks for validation", min=0.01, max=0.9),
    ] = 0.1,
    seed: options.Seed = 0,
    lights: options.LightsFile = None,
    hdmap: options.HDMapFile = None,
    stop_lines: options.StopLinesFile = None,
    tracks_world: options.TracksWorld = None,
    tracks_resolution: options.TracksResolution = None,
) -> None:
    """Train a prediction model on your map: fine-tune a trained model, or start from scratch.

    An interrupted training resumes when the same command is called again. Use the model with
    --weights FOLDER/model.pt in predict and evaluate; give evaluate the same --val-fraction. To
    train on several recordings use the Python functions make_dataset and train.

    Example: geoaim train map.tif --tracks samples/tracks.csv --val-fraction 0.4 -o model
    """
    from geoaim.prediction.config import configure_fine_tuning, configure_training
    from geoaim.prediction.dataset import make_dataset
    from geoaim.prediction.report import plot_training
    from geoaim.prediction.training import train as train_model

    with show_progress() as progress, report_errors():
        check_output(output / "model.pt", inputs=[weights])
        model = _init_model(weights, kind, seed) if scratch else load_model(weights, kind)
        source = SceneSource(
            aim, tracks, tracks_world, tracks_resolution, lights, hdmap, stop_lines
        )
        scene, _, _ = read_scene(source, rate=1 / model.config.dt)
        dataset = make_dataset([scene], model.config, val_fraction=val_fraction, progress=progress)
        configure = configure_training if scratch else configure_fine_tuning
        config = configure(model.config.kind, steps=steps, batch_size=batch_size, seed=seed)
        config = replace(config, checkpoint_interval=CHECKPOINT_STEPS)
        try:
            train_model(model, config, dataset, output, progress=progress)
        except (KeyboardInterrupt, SystemExit):
            console.print(_describe_checkpoint(output))
            raise
        plot_training(output / "log.csv", output / "curves.png")
    console.print(
        f"{output / 'model.pt'}: trained on {len(dataset.train)} segments, validated on "
        f"{len(dataset.val)} of the last {100 * val_fraction:g} %: "
        f"{_summarize_log(output / 'log.csv')}; see {output / 'curves.png'}"
    )


def _init_model(weights: Path | None, kind: options.AgentKind, seed: int) -> "ITRA":
    """Make a model with random weights."""
    from geoaim.prediction.config import DEFAULT_CONFIGS
    from geoaim.prediction.training import init_model

    default = DEFAULT_CONFIGS[kind.removesuffix("s")]
    return init_model(default if weights is None else load_model(weights, kind).config, seed=seed)


def _describe_checkpoint(folder: Path) -> str:
    if not (folder / "log.csv").exists():
        return f"{folder} has no checkpoint yet; the same command starts again"
    step = (folder / "log.csv").read_text(encoding="utf-8").splitlines()[-1].split(",")[0]
    return f"{folder / 'checkpoint.pt'} is kept; the same command goes on after step {step}"


def _summarize_log(log: Path) -> str:
    """Compare minADE in the first and the last row of a training log."""
    rows = list(csv.DictReader(log.read_text(encoding="utf-8").splitlines()))
    return ", ".join(
        f"minADE {float(row['minADE']):.2f} m after step {row['step']}"
        for row in (rows[0], rows[-1])
    )
