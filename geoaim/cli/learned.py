"""Commands that predict, judge predictions, train, and repeat the paper's experiments."""

import csv
import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from geoaim.cli.console import (
    AimFile,
    TracksFile,
    TracksPixel,
    TracksWorld,
    console,
    plain_errors,
    refuse_output,
    stages,
)
from geoaim.cli.driving import HDMapFile, LightsFile, StopLinesFile, read_scene
from geoaim.errors import GeoaimWarning
from geoaim.progress import Progress

if TYPE_CHECKING:
    from geoaim.prediction.itra import ITRA

Kind = Literal["vehicle", "pedestrian"]
Weights = Annotated[
    Path | None, typer.Option("--weights", help="a model.pt; if left out the one that is shipped")
]
Samples = Annotated[int, typer.Option(help="futures to draw", min=1)]
USUAL = {"vehicle": 4.0, "pedestrian": 8.0}  # s that are predicted
Seed = Annotated[int, typer.Option(help="of the noise", min=0)]


def predict(
    aim: AimFile,
    tracks: TracksFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", help=".csv, .png, .mp4 or .gif to write")
    ],
    kind: Annotated[Kind, typer.Option(help="whose futures")] = "vehicle",
    weights: Weights = None,
    at: Annotated[
        float | None,
        typer.Option(help="s, the last time that is known; the tracks' end if left out"),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="to predict; 4 for vehicles, 8 for pedestrians", min=0.1)
    ] = None,
    samples: Samples = 6,
    seed: Seed = 0,
    lights: LightsFile = None,
    hdmap: HDMapFile = None,
    stop_lines: StopLinesFile = None,
    tracks_world: TracksWorld = None,
    tracks_resolution: TracksPixel = None,
) -> None:
    """Draw what may happen next: sampled futures of all vehicles, or of all people, jointly.

    Others replay what the tracks say. A .csv has a row for each sample, agent and time; pictures
    show the map with all samples, and in white what really happened, where --at leaves some of
    it. --seconds of a model with plans are those that it was taught.
    """
    import torch

    from geoaim.prediction.cutting import select_kind
    from geoaim.prediction.pictures import draw_futures, film_futures, write_futures
    from geoaim.prediction.predict import predict as foresee
    from geoaim.simulation.pictures import write_pictures
    from geoaim.simulation.scene import step_at_time

    with stages() as progress, plain_errors():
        refuse_output(output, (".csv", ".png", ".mp4", ".gif"), [aim, tracks, lights, hdmap])
        model = _model(weights, kind)
        agents = (tracks, tracks_world, tracks_resolution)
        scene, _, world = read_scene(
            aim, agents, lights, hdmap, stop_lines, rate=1 / model.config.dt
        )
        start = step_at_time(scene, at)
        progress("predict", 0, 1)
        steps = max(1, round((seconds or USUAL[kind]) / model.config.dt))
        generator = torch.Generator().manual_seed(seed)
        futures = foresee(
            model, scene, samples=samples, horizon=steps, start=start, generator=generator
        )
        progress("predict", 1, 1)
        if output.suffix.lower() == ".csv":
            write_futures(scene, futures, start, output, world=world, dt=model.config.dt)
        elif output.suffix.lower() == ".png":
            write_pictures([draw_futures(scene, futures, start)], output, rate=1.0)
        else:
            frames = film_futures(scene, futures, start)
            write_pictures(frames, output, rate=1 / model.config.dt)
    moved = int((select_kind(scene, kind) & scene.present[:, start]).sum())
    console.print(
        f"{output}: {samples} futures of {steps * model.config.dt:g} s after "
        f"{float(scene.times[start]):g} s, {moved} agents"
    )


def train(
    aim: AimFile,
    tracks: TracksFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="folder for model.pt, log.csv, curves.png")
    ],
    kind: Annotated[Kind, typer.Option(help="who is learnt from")] = "vehicle",
    weights: Weights = None,
    scratch: Annotated[
        bool, typer.Option("--scratch", help="begin with random weights of the same form")
    ] = False,
    steps: Annotated[int, typer.Option(help="of the optimiser", min=1)] = 200,
    batch: Annotated[int, typer.Option(help="segments of a step", min=1)] = 32,
    held_out: Annotated[
        float, typer.Option(help="share at the tracks' end to check with", min=0.01, max=0.9)
    ] = 0.1,
    seed: Seed = 0,
    lights: LightsFile = None,
    hdmap: HDMapFile = None,
    stop_lines: StopLinesFile = None,
    tracks_world: TracksWorld = None,
    tracks_resolution: TracksPixel = None,
) -> None:
    """Teach a model what happens on your map: from the shipped weights on, or from scratch.

    An interrupted run goes on where it was when it is called again in the same way. Predict and
    evaluate with --weights FOLDER/model.pt then, the latter with --last for what was held out. More
    recordings at once take the Python functions make_dataset and train.
    """
    from geoaim.prediction.config import (
        DEFAULT_CONFIGS,
        configure_fine_tuning,
        configure_training,
    )
    from geoaim.prediction.dataset import make_dataset
    from geoaim.prediction.report import plot_training
    from geoaim.prediction.training import init_model
    from geoaim.prediction.training import train as learn

    with stages() as progress, plain_errors():
        refuse_output(output / "model.pt", inputs=[weights])
        if scratch:
            config = DEFAULT_CONFIGS[kind] if weights is None else _model(weights, kind).config
            model = init_model(config, seed=seed)
        else:
            model = _model(weights, kind)
        agents = (tracks, tracks_world, tracks_resolution)
        scene, _, _ = read_scene(aim, agents, lights, hdmap, stop_lines, rate=1 / model.config.dt)
        dataset = make_dataset([scene], model.config, val_fraction=held_out, progress=progress)
        configure = configure_training if scratch else configure_fine_tuning
        training = configure(kind, steps=steps, batch_size=batch, seed=seed)
        training = replace(training, checkpoint_interval=50)
        learn(model, training, dataset, output, progress=progress)
        plot_training(output / "log.csv", output / "curves.png")
    console.print(
        f"{output / 'model.pt'}: learnt from {len(dataset.train)} segments, checked with "
        f"{len(dataset.val)} of the last {100 * held_out:g} %: {_progress(output / 'log.csv')}; "
        f"{output / 'curves.png'} shows how"
    )


def evaluate(
    aim: Annotated[
        Path | None, typer.Argument(help="an AIM, with --tracks; or give --windows instead")
    ] = None,
    tracks: Annotated[
        Path | None, typer.Option(help="tracks on the AIM, of any known form")
    ] = None,
    windows: Annotated[
        Path | None, typer.Option(help="folder of <scene>.csv: frame, track, u_px, v_px; 8 + 12")
    ] = None,
    images: Annotated[Path | None, typer.Option(help="folder of <scene>.jpg; none: no map")] = None,
    scenes: Annotated[
        Path | None, typer.Option(help="table of the windows' scenes: scene, metres_per_pixel")
    ] = None,
    kind: Annotated[Kind, typer.Option(help="who is judged, on an AIM")] = "vehicle",
    weights: Weights = None,
    samples: Samples = 6,
    last: Annotated[
        float,
        typer.Option(
            help="share of the tracks' end to judge: what train held out", min=0.01, max=1.0
        ),
    ] = 1.0,
    seed: Seed = 0,
    lights: LightsFile = None,
    hdmap: Annotated[
        Path | None, typer.Option(help="lanelet2 map: stop lines, and what is off the road")
    ] = None,
    stop_lines: StopLinesFile = None,
    tracks_world: TracksWorld = None,
    tracks_resolution: TracksPixel = None,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON instead of a table")] = False,
) -> None:
    """Judge a model beside constant velocity, with and without noise, and constant turn rate.

    On an AIM with tracks, by minADE, minFDE, MFD and what goes wrong; on windows of the Stanford
    Drone Dataset's form, by minADE and minFDE in pixels and metres. Intervals of 95 % are by
    bootstrap.
    """
    from geoaim.prediction.baselines import BASELINES
    from geoaim.prediction.evaluation import evaluate_windows, make_window_predictor
    from geoaim.prediction.metrics import summarise
    from geoaim.prediction.report import format_markdown
    from geoaim.prediction.windows import WindowFiles, read_windows

    with stages() as progress, plain_errors():
        if (aim is None) == (windows is None) or (aim is None) != (tracks is None):
            raise ValueError("give either an AIM with --tracks, or --windows with --scenes")
        if windows is not None:
            if scenes is None:
                raise ValueError("--windows needs --scenes: metres a pixel of each scene")
            if weights is None:
                raise ValueError(
                    "--windows needs --weights, of a model that was trained on windows"
                )
            model = _model(weights, None)
            if images is None and model.config.use_observations:
                warnings.warn(
                    "the model learnt to see maps, and sees grey without --images",
                    GeoaimWarning,
                    stacklevel=1,
                )
            there = read_windows(WindowFiles(windows, images, scenes), model.config.view)
            predictors = {"model": make_window_predictor(model, samples), **BASELINES}
            judged = {
                name: evaluate_windows(predictor, there, samples, seed=seed, progress=progress)
                for name, predictor in predictors.items()
            }
            count = len(there.segments)
        else:
            model = _model(weights, kind)
            given = (aim, (tracks, tracks_world, tracks_resolution), lights, hdmap, stop_lines)
            judged, count = _judged(model, given, last, (samples, seed), progress)
    found = {name: summarise(measures) for name, measures in judged.items()}
    if as_json:
        flat = {name: value["mean"] for name, value in found["model"].items()}
        name = "windows" if windows is not None else "segments"
        print(json.dumps({**flat, name: count, "samples": samples, "methods": found}, indent=1))
    else:
        print(format_markdown(found))
        ahead = "12 steps" if windows is not None else f"{USUAL[kind]:g} s"
        console.print(
            f"{count} pieces, {samples} samples of {ahead} ahead, m (px where a name says so); "
            "rates are of agents, samples and steps; intervals of 95 %"
        )


def experiment(
    name: Annotated[str, typer.Argument(help="which one; 'list' says what there is")],
    folder: Annotated[
        Path, typer.Option("--folder", help="where places and models are kept")
    ] = Path("build/experiments"),
    results: Annotated[Path, typer.Option(help="folder for tables and figures")] = Path(
        "docs/experiments"
    ),
) -> None:
    """Repeat an experiment: made places or real data, models, tables and figures.

    What is in the folder already is used, so that an interrupted run goes on where it was.
    'pretrained' writes the package's models anew, to FOLDER/pretrained. Real data are looked for
    in GEOAIM_DATA.
    """
    from geoaim.experiments import EXPERIMENTS
    from geoaim.experiments.results import Workspace

    with stages() as progress, plain_errors():
        if name == "list":
            for key, run in EXPERIMENTS.items():
                console.print(f"{key}: {run.__doc__}")
            return
        if name not in EXPERIMENTS:
            raise ValueError(f"there is no experiment {name!r}; 'list' says what there is")
        written = EXPERIMENTS[name](Workspace(folder, results, progress))
    console.print(", ".join(str(path) for path in written))


def _progress(log: Path) -> str:
    """How far minADE came, first and last row of a training's log."""
    rows = list(csv.DictReader(log.read_text(encoding="utf-8").splitlines()))
    first, last = (float(row["minADE"]) for row in (rows[0], rows[-1]))
    return (
        f"minADE {first:.2f} m after step {rows[0]['step']}, {last:.2f} m after {rows[-1]['step']}"
    )


def _judged(
    model: "ITRA", given: tuple[Any, ...], last: float, draws: tuple[int, int], progress: Progress
) -> tuple[Any, int]:
    """Measures of everybody on joint segments of a scene, and how many segments there are."""
    from geoaim.prediction.baselines import BASELINES
    from geoaim.prediction.config import MAX_HISTORY_STEPS
    from geoaim.prediction.cutting import cut_segments
    from geoaim.prediction.dataset import split_scene
    from geoaim.prediction.evaluation import EvalConfig, evaluate
    from geoaim.simulation.episodes import check_place, rules_of
    from geoaim.simulation.ground import fit_ground

    scene, known, _ = read_scene(*given, rate=1 / model.config.dt)
    rules = rules_of(known)
    check_place(scene, rules)
    samples, seed = draws
    _, scene = split_scene(scene, last)
    steps = MAX_HISTORY_STEPS + round(USUAL[model.config.kind] / model.config.dt)
    segments = cut_segments(scene, model.config.kind, steps=steps, stride=steps, joint=True)
    ground = fit_ground(scene.ground, model.config.resolution)
    options = EvalConfig(MAX_HISTORY_STEPS, samples, seed=seed)
    judged = {
        name: evaluate(predictor, segments, ground, options, rules=rules, progress=progress)
        for name, predictor in {"model": model.sample, **BASELINES}.items()
    }
    return judged, len(segments)


def _model(weights: Path | None, kind: str | None) -> "ITRA":
    """The model of a file, or the one that is shipped for a kind."""
    from geoaim.prediction.checkpoints import read_model, read_pretrained

    model = read_pretrained(str(kind)) if weights is None else read_model(weights)
    if kind is not None and model.config.kind != kind:
        raise ValueError(
            f"{weights} is a model of {model.config.kind}s; say --kind {model.config.kind}"
        )
    return model
