"""The command that evaluates a prediction model."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from geoaim.base.defaults import SAMPLES
from geoaim.base.errors import warn
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


# metrics by predictor and name; "segments" or "windows", and how many; predicted time with unit
Result = tuple[dict[str, dict[str, Any]], str, int, str]


@take_scene_files
def evaluate(
    aim: Annotated[
        Path | None, typer.Argument(help="AIM, with --tracks; or give --windows instead")
    ] = None,
    tracks: options.SceneTracks = None,
    windows: options.WindowsFolder = None,
    images: options.WindowImages = None,
    scenes: options.WindowScenes = None,
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
            "--realism",
            help="on an AIM: also the realism of the Waymo Open Sim Agents Challenge (WOSAC)",
        ),
    ] = False,
    seed: options.Seed = 0,
    as_json: options.AsJson = False,
    *,
    files: SceneFiles,
) -> None:
    """Evaluate a prediction model and compare it with constant-velocity and -turn-rate baselines.

    With --val-fraction also with a plain network of an agent's own past, which is trained on the
    beginning of the tracks in seconds.

    On an AIM with tracks: minADE (how far the closest of the samples is from what was driven),
    minFDE, MFD, collisions and traffic violations, also those of the recording itself, and with
    --realism how likely it is under the samples. On windows of the Stanford Drone Dataset: minADE
    and minFDE in pixels and metres. Confidence intervals of 95 % are bootstrapped.

    Example: geoaim evaluate map.tif --tracks samples/tracks.csv --hdmap samples/map.osm
    """
    with show_progress() as progress, report_errors():
        if (aim is None) == (windows is None) or (aim is None) != (tracks is None):
            raise ValueError("give either an AIM with --tracks, or --windows with --scenes")
        if aim is not None and tracks is not None:
            source = SceneSource(aim, tracks, **files)
            model = load_model(weights, kind)
            config = {"samples": samples, "seed": seed, "realism": realism}
            result = _evaluate_on_map(source, model, val_fraction, config, progress)
        elif windows is None or scenes is None:
            raise ValueError("--windows needs --scenes, for the metres per pixel of each scene")
        elif weights is None:
            raise ValueError("--windows needs --weights of a model that was trained on windows")
        else:
            model, windows_files = load_model(weights), (windows, images, scenes)
            result = _evaluate_on_windows(windows_files, model, samples, seed, progress)
    print_result(result, samples, as_json)


def _evaluate_on_map(
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
    from geoaim.simulation.road_rules import check_rules, make_road_rules

    config, horizon = model.config, get_horizon(model)
    scene, hdmap, _ = read_scene(source, rate=1 / config.dt)
    rules = check_rules(scene, make_road_rules(hdmap))
    predictors: dict[str, Predictor] = {"model": model.sample, **BASELINES}
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
    return metrics, "segments", count, f"{horizon * config.dt:g} s"


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


def _evaluate_on_windows(
    files: tuple[Path, Path | None, Path],
    model: "ITRA",
    samples: int,
    seed: int,
    progress: Progress,
) -> Result:
    """Evaluate a model and baselines on TrajNet windows: their folders and table."""
    from geoaim.prediction import windows
    from geoaim.prediction.baselines import BASELINES
    from geoaim.prediction.evaluation import evaluate_windows, make_window_predictor

    if files[1] is None and model.config.use_observations:
        warn("the model was trained with maps; without --images it gets a uniform grey one")
    data = windows.read_windows(windows.WindowFiles(*files), model.config.view)
    predictors = {"model": make_window_predictor(model, samples), **BASELINES}
    metrics = {
        name: evaluate_windows(predictor, data, samples, seed=seed, progress=progress)
        for name, predictor in predictors.items()
    }
    horizon = windows.WINDOW_STEPS - windows.HISTORY_STEPS
    return metrics, "windows", len(data.segments), f"{horizon} steps"


def print_result(result: Result, samples: int, as_json: bool = False) -> None:
    """Print metrics as a table, a column for each method, or as JSON."""
    from geoaim.prediction.metrics import MIN_SEGMENTS, summarise
    from geoaim.prediction.report import format_cell

    metrics, unit, count, horizon = result
    summaries = {name: summarise(values) for name, values in metrics.items()}
    if as_json:
        means = {name: value["mean"] for name, value in summaries["model"].items()}
        content = {**means, unit: count, "samples": samples}
        print(json.dumps({**content, "methods": summaries}, indent=1))
        return
    names = list(dict.fromkeys(name for summary in summaries.values() for name in summary))
    table = Table("", *summaries)
    for name in names:
        cells = [format_cell(s[name]) if name in s else "" for s in summaries.values()]
        table.add_row(name, *cells)
    console.print(table)
    few = f"no intervals, which need {MIN_SEGMENTS} {unit} or more: give longer tracks"
    intervals = few if count < MIN_SEGMENTS else "95 % intervals"
    console.print(
        f"{count} {unit}, {samples} samples of {horizon}; metres, or pixels where a name says px; "
        f"rates per agent, sample and step; {intervals}"
    )
