"""The command that evaluates a prediction model."""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from geoaim.base.defaults import SAMPLES
from geoaim.base.progress import Progress
from geoaim.cli import options
from geoaim.cli.console import console, report_errors, show_progress
from geoaim.cli.inputs import (
    SceneFiles,
    SceneSource,
    get_horizon,
    load_model,
    read_scene,
    take_scene_files,
)

if TYPE_CHECKING:
    from geoaim.prediction.itra import ITRA
    from geoaim.prediction.plain import PlainNetwork
    from geoaim.rendering.scene import Scene


# metrics by predictor and name; how many segments; predicted time with unit
Result = tuple[dict[str, dict[str, Any]], int, str]


@take_scene_files
def evaluate(
    aim: Annotated[Path, typer.Argument(help="AIM, or the folder of geoaim place")],
    *,
    tracks: options.SceneTracks = None,
    kind: options.Kind = "vehicles",
    weights: options.WeightsFile = None,
    samples: options.Samples = SAMPLES,
    val_fraction: Annotated[
        float,
        typer.Option(
            help="evaluate on this last fraction of the tracks, as given to train",
            min=0.01,
            max=1.0,
        ),
    ] = 1.0,
    realism: Annotated[
        bool,
        typer.Option(
            "--realism", help="also the realism of the Waymo Open Sim Agents Challenge (WOSAC)"
        ),
    ] = False,
    seed: options.Seed = 0,
    as_json: options.AsJson = False,
    files: SceneFiles,
) -> None:
    """Evaluate a prediction model and compare it with constant-velocity and -turn-rate baselines.

    With --val-fraction also with a plain network of an agent's own past, which is trained on the
    beginning of the tracks in seconds. The model's futures are those that predict gives; with
    --realism plain draws, of which those likelihoods are made.

    Metrics are minADE (how far the closest of the samples is from what was driven), minFDE, MFD,
    collisions and traffic violations, also those of the recording itself, and with --realism how
    likely it is under the samples. Confidence intervals of 95 % are bootstrapped.

    Example: geoaim evaluate map.tif --tracks samples/tracks.csv --hdmap samples/map.osm
    """
    with show_progress() as progress, report_errors():
        if tracks is None:
            raise ValueError(f"{aim} has no tracks to judge by; give them with --tracks")
        source = SceneSource(aim, tracks, **files)
        config = {"samples": samples, "seed": seed, "realism": realism}
        result = _evaluate(source, load_model(weights, kind), val_fraction, config, progress)
    print_result(result, samples, as_json)


def _evaluate(
    source: SceneSource,
    model: "ITRA",
    fraction: float,
    choices: Mapping[str, Any],
    progress: Progress,
) -> Result:
    """Evaluate a model and baselines jointly for all agents of its kind on a scene."""
    from geoaim.prediction.baselines import BASELINES, Predictor, replay
    from geoaim.prediction.config import MAX_HISTORY_STEPS
    from geoaim.prediction.evaluation import RECORDING, EvalConfig, judge
    from geoaim.prediction.predict import draw_covering
    from geoaim.simulation.road_rules import check_rules, make_road_rules

    config, horizon = model.config, get_horizon(model)
    scene, hdmap, _ = read_scene(source, rate=1 / config.dt)
    rules = check_rules(scene, make_road_rules(hdmap))
    draw = model.sample if choices["realism"] else partial(draw_covering, model)
    predictors: dict[str, Predictor] = {"model": draw, **BASELINES}
    plain = train_on_beginning(model, [scene], fraction)
    if plain is not None:
        predictors["plain network"] = plain.sample
    metrics = judge(
        {**predictors, RECORDING: replay},
        [scene],
        config,
        EvalConfig(MAX_HISTORY_STEPS, **choices),
        fraction=fraction,
        horizon=horizon,
        rules=rules,
        progress=progress,
    )
    count = len(metrics["model"]["minADE"].sums)
    return metrics, count, f"{horizon * config.dt:g} s"


def train_on_beginning(
    model: "ITRA", scenes: "Sequence[Scene]", fraction: float
) -> "PlainNetwork | None":
    """Train the plain network on what comes before the end of scenes; None if that is too short."""
    from geoaim.prediction.config import MAX_HISTORY_STEPS
    from geoaim.prediction.dataset import cut_beginnings
    from geoaim.prediction.plain import train_plain

    if model.config.motion == "slide":
        return None
    steps = MAX_HISTORY_STEPS + get_horizon(model)
    segments = cut_beginnings(scenes, model.config, fraction, steps)
    if segments is None:
        return None
    return train_plain(segments, model.config, history=MAX_HISTORY_STEPS)


def print_result(result: Result, samples: int, as_json: bool = False) -> None:
    """Print metrics as a table, a column for each method, or as JSON."""
    from geoaim.prediction.metrics import MIN_SEGMENTS, summarise
    from geoaim.prediction.report import format_cell

    metrics, count, horizon = result
    summaries = {name: summarise(values) for name, values in metrics.items()}
    if as_json:
        means = {name: value["mean"] for name, value in summaries["model"].items()}
        content = {**means, "segments": count, "samples": samples}
        print(json.dumps({**content, "methods": summaries}, indent=1))
        return
    names = list(dict.fromkeys(name for summary in summaries.values() for name in summary))
    table = Table("", *summaries)
    for name in names:
        cells = [format_cell(s[name]) if name in s else "" for s in summaries.values()]
        table.add_row(name, *cells)
    console.print(table)
    few = f"no intervals, which need {MIN_SEGMENTS} segments or more: give longer tracks"
    intervals = few if count < MIN_SEGMENTS else "95 % intervals"
    console.print(
        f"{count} segments, {samples} samples of {horizon}; metres; rates per agent, sample and "
        f"step; {intervals}"
    )
