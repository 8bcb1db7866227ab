"""The command that evaluates a prediction model."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from geoaim.cli import options
from geoaim.cli.console import console, report_errors, show_progress
from geoaim.cli.inputs import SceneSource, get_horizon, load_model, read_scene
from geoaim.errors import warn
from geoaim.progress import Progress


@dataclass(frozen=True)
class _Settings:
    """Settings of both evaluations."""

    weights: Path | None
    samples: int
    seed: int
    progress: Progress


@dataclass(frozen=True, eq=False)
class _Results:
    """Results of an evaluation."""

    metrics: dict[str, dict[str, Any]]  # by predictor and metric
    unit: str  # "segments" or "windows"
    count: int
    horizon: str  # predicted time, with its unit


def evaluate(
    aim: Annotated[
        Path | None, typer.Argument(help="AIM, with --tracks; or give --windows instead")
    ] = None,
    tracks: options.OptionalTracks = None,
    windows: Annotated[
        Path | None,
        typer.Option(help="folder of TrajNet windows: <scene>.csv with frame, track, u_px, v_px"),
    ] = None,
    images: Annotated[
        Path | None, typer.Option(help="folder of the windows' maps: <scene>.jpg")
    ] = None,
    scenes: Annotated[
        Path | None, typer.Option(help="table of the windows' scenes: scene, metres_per_pixel")
    ] = None,
    kind: options.Kind = "vehicles",
    weights: options.WeightsFile = None,
    samples: options.Samples = 6,
    val_fraction: Annotated[
        float,
        typer.Option(
            help="evaluate on this last fraction of the tracks, as given to train",
            min=0.01,
            max=1.0,
        ),
    ] = 1.0,
    seed: options.Seed = 0,
    lights: options.LightsFile = None,
    hdmap: options.HDMapFile = None,
    stop_lines: options.StopLinesFile = None,
    tracks_world: options.TracksWorld = None,
    tracks_resolution: options.TracksResolution = None,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """Evaluate a prediction model and compare it with constant-velocity and -turn-rate baselines.

    On an AIM with tracks: minADE, minFDE, MFD, collisions and traffic violations. On windows of
    the Stanford Drone Dataset: minADE and minFDE in pixels and metres. Confidence intervals of
    95 % are bootstrapped.

    Example: geoaim evaluate map.tif --tracks samples/tracks.csv --hdmap samples/map.osm
    """
    with show_progress() as progress, report_errors():
        if (aim is None) == (windows is None) or (aim is None) != (tracks is None):
            raise ValueError("give either an AIM with --tracks, or --windows with --scenes")
        settings = _Settings(weights, samples, seed, progress)
        if aim is not None and tracks is not None:
            source = SceneSource(
                aim, tracks, tracks_world, tracks_resolution, lights, hdmap, stop_lines
            )
            results = _evaluate_on_map(source, kind, val_fraction, settings)
        elif windows is not None and scenes is not None:
            results = _evaluate_on_windows(windows, images, scenes, settings)
        else:
            raise ValueError("--windows needs --scenes, for the metres per pixel of each scene")
    _print_results(results, samples, as_json)


def _evaluate_on_map(
    source: SceneSource, kind: options.AgentKind, fraction: float, settings: _Settings
) -> _Results:
    """Evaluate the model and baselines jointly for all agents of a kind on a scene."""
    from geoaim.prediction.baselines import BASELINES
    from geoaim.prediction.config import MAX_HISTORY_STEPS
    from geoaim.prediction.cutting import cut_segments
    from geoaim.prediction.dataset import split_scene
    from geoaim.prediction.evaluation import EvalConfig
    from geoaim.prediction.evaluation import evaluate as evaluate_predictor
    from geoaim.simulation.ground import prefilter_ground
    from geoaim.simulation.road_rules import check_rules, make_road_rules

    model = load_model(settings.weights, kind)
    config, horizon = model.config, get_horizon(model)
    whole, hdmap, _ = read_scene(source, rate=1 / config.dt)
    rules = make_road_rules(hdmap)
    check_rules(whole, rules)
    _, scene = split_scene(whole, fraction)
    steps = MAX_HISTORY_STEPS + horizon
    segments = cut_segments(scene, config.kind, steps=steps, stride=steps, joint=True)
    ground = prefilter_ground(scene.ground, config.resolution)
    evaluation = EvalConfig(MAX_HISTORY_STEPS, settings.samples, seed=settings.seed)
    metrics = {
        name: evaluate_predictor(
            predictor, segments, ground, evaluation, rules=rules, progress=settings.progress
        )
        for name, predictor in {"model": model.sample, **BASELINES}.items()
    }
    return _Results(metrics, "segments", len(segments), f"{horizon * config.dt:g} s")


def _evaluate_on_windows(
    windows: Path, images: Path | None, scenes: Path, settings: _Settings
) -> _Results:
    """Evaluate the model and baselines on TrajNet windows."""
    from geoaim.prediction.baselines import BASELINES
    from geoaim.prediction.evaluation import evaluate_windows, make_window_predictor
    from geoaim.prediction.windows import HISTORY_STEPS, WINDOW_STEPS, WindowFiles, read_windows

    if settings.weights is None:
        raise ValueError("--windows needs --weights of a model that was trained on windows")
    model = load_model(settings.weights)
    if images is None and model.config.use_observations:
        warn("the model was trained with maps; without --images it gets a uniform grey one")
    data = read_windows(WindowFiles(windows, images, scenes), model.config.view)
    samples, seed = settings.samples, settings.seed
    predictors = {"model": make_window_predictor(model, samples), **BASELINES}
    metrics = {
        name: evaluate_windows(predictor, data, samples, seed=seed, progress=settings.progress)
        for name, predictor in predictors.items()
    }
    return _Results(metrics, "windows", len(data.segments), f"{WINDOW_STEPS - HISTORY_STEPS} steps")


def _print_results(results: _Results, samples: int, as_json: bool) -> None:
    """Print metrics as a Markdown table or as JSON."""
    from geoaim.prediction.metrics import summarise
    from geoaim.prediction.report import format_markdown

    summaries = {name: summarise(metrics) for name, metrics in results.metrics.items()}
    if as_json:
        means = {name: value["mean"] for name, value in summaries["model"].items()}
        content = {**means, results.unit: results.count, "samples": samples}
        print(json.dumps({**content, "methods": summaries}, indent=1))
        return
    print(format_markdown(summaries))
    console.print(
        f"{results.count} {results.unit}, {samples} samples of {results.horizon}; metres, or "
        "pixels where a name says px; rates per agent, sample and step; 95 % intervals"
    )
