"""The command that trains a prediction model."""

import csv
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from geoaim.cli import options
from geoaim.cli.console import console, report_errors, show_progress
from geoaim.cli.inputs import SceneSource, load_model
from geoaim.cli.outputs import check_output

if TYPE_CHECKING:
    from geoaim.prediction.itra import ITRA

CHECKPOINT_STEPS = 50  # steps from one checkpoint to the next


def train(
    aim: Annotated[
        Path,
        typer.Argument(
            help="AIM, with --tracks; or a table of recordings, .csv, with the columns aim, "
            "tracks and, where needed, tracks_world, lights, hdmap, ..."
        ),
    ],
    output: Annotated[Path, options.output("folder for model.pt, log.csv and curves.png")],
    tracks: options.OptionalTracks = None,
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
    learning_rate: Annotated[
        float | None,
        typer.Option(help="highest learning rate; 0.0005, or 0.002 from scratch", min=1e-8),
    ] = None,
    segment_duration: Annotated[
        float | None,
        typer.Option(help="seconds of a training segment; 4 of vehicles, 12 of pedestrians"),
    ] = None,
    view_size: Annotated[
        int | None, typer.Option(help="side of a view, pixels, with --scratch", min=8)
    ] = None,
    view_resolution: Annotated[
        float | None, typer.Option(help="metres per pixel of a view, with --scratch", min=0.01)
    ] = None,
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
    tracks_frame_rate: options.TracksFrameRate = None,
) -> None:
    """Train a prediction model on your map: fine-tune a trained model, or start from scratch.

    An interrupted training resumes when the same command is called again. Use the model with
    --weights FOLDER/model.pt in predict and evaluate; give evaluate the same --val-fraction.

    Example: geoaim train map.tif --tracks samples/tracks.csv --val-fraction 0.4 -o model
    """
    from geoaim.cli.scene_tables import read_scene_sources, read_scenes
    from geoaim.prediction.config import configure_fine_tuning, configure_training
    from geoaim.prediction.dataset import make_dataset
    from geoaim.prediction.report import plot_training
    from geoaim.prediction.training import train as train_model

    with show_progress() as progress, report_errors():
        check_output(output / "model.pt", inputs=[weights])
        view = {"view_size": view_size, "resolution": view_resolution}
        view = {name: value for name, value in view.items() if value is not None}
        if view and not scratch:
            raise ValueError("a trained model keeps its view; give --scratch with a view's options")
        model = _init_model(weights, kind, seed, view) if scratch else load_model(weights, kind)
        given = tracks, tracks_world, tracks_resolution, tracks_frame_rate
        sources = [SceneSource(aim, *given, lights, hdmap, stop_lines)]
        if aim.suffix.lower() == ".csv":
            if any((*given, lights, hdmap, stop_lines)):
                raise ValueError(
                    f"{aim} names the files of each recording; leave their options out"
                )
            sources = read_scene_sources(aim)
        dt = model.config.dt
        dataset = make_dataset(
            read_scenes(sources, 1 / dt, progress),
            model.config,
            val_fraction=val_fraction,
            segment_steps=None if segment_duration is None else round(segment_duration / dt),
            progress=progress,
        )
        configure = configure_training if scratch else configure_fine_tuning
        config = configure(model.config.kind, steps=steps, batch_size=batch_size, seed=seed)
        rate = learning_rate or config.learning_rate
        config = replace(config, checkpoint_interval=CHECKPOINT_STEPS, learning_rate=rate)
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


def _init_model(
    weights: Path | None, kind: options.AgentKind, seed: int, view: Mapping[str, Any]
) -> "ITRA":
    """Make a model with random weights; `view` replaces fields of its configuration."""
    from geoaim.prediction.config import DEFAULT_CONFIGS
    from geoaim.prediction.training import init_model

    default = DEFAULT_CONFIGS[kind.removesuffix("s")]
    config = default if weights is None else load_model(weights, kind).config
    return init_model(replace(config, **view), seed=seed)


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
