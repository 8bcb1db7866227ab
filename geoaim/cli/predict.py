"""Commands that predict futures on one map, and on several side by side."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from geoaim.base.defaults import MAX_HISTORY_STEPS, SAMPLES
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
from geoaim.cli.outputs import check_output

if TYPE_CHECKING:
    from geoaim.prediction.futures import Futures
    from geoaim.prediction.itra import ITRA


@take_scene_files
def predict(
    aim: options.AimFile,
    output: Annotated[Path, options.output(".csv, .png, .mp4 or .gif to write")],
    tracks: options.SceneTracks = None,
    kind: options.Kind = "vehicles",
    weights: options.WeightsFile = None,
    start: Annotated[
        float | None, typer.Option(help="last observed time, s; the end of the tracks if omitted")
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(
            help="predicted time, s; 4 for vehicles, 8 for pedestrians and 6 for cyclists if "
            "omitted. A model with trajectory proposals has a fixed one",
            min=0.1,
        ),
    ] = None,
    samples: options.Samples = SAMPLES,
    seed: options.Seed = 0,
    *,
    files: SceneFiles,
) -> None:
    """Predict futures of all vehicles, or of all pedestrians, jointly.

    All other agents keep their speed and heading; those whose own speed is too unsure do too, and
    are counted as left out. The pretrained model is first tested on what was recorded before
    --start, beside constant velocity with noise, which is mixed in where the model is no better.
    A .csv has a row for each sample, agent and time.
    Pictures show all samples on the map, and in white the recorded future, if there is one after
    --start.

    Example: geoaim predict map.tif --tracks samples/tracks.csv --start 20 -o futures.png
    """
    import torch

    from geoaim.base.files import write_figure
    from geoaim.prediction.pictures import draw_futures, film_futures, write_futures
    from geoaim.prediction.predict import predict as predict_futures
    from geoaim.prediction.sureness import describe_left_out
    from geoaim.prediction.trial import choose_noise, describe_trial, judge_before
    from geoaim.rendering.pictures import write_pictures
    from geoaim.rendering.scene import find_step

    with show_progress() as progress, report_errors():
        inputs = [aim, tracks, files["lights"], files["hdmap"]]
        check_output(output, (".csv", ".png", ".mp4", ".gif"), inputs)
        model = load_model(weights, kind)
        source = SceneSource(aim, tracks, **files)
        scene, _, _ = read_scene(source, rate=1 / model.config.dt)
        first, horizon = find_step(scene, start), get_horizon(model, duration)
        progress("predict", 0, 1)
        tried = {} if weights else judge_before(model, scene, first, horizon)
        futures = predict_futures(
            model,
            scene,
            samples=samples,
            horizon=horizon,
            start=first,
            noise=choose_noise(tried),
            generator=torch.Generator().manual_seed(seed),
        )
        progress("predict", 1, 1)
        told = "" if weights else describe_trial(tried)
        if output.suffix.lower() == ".csv":
            write_futures(futures, output, notes=[told] if told else [])
        elif output.suffix.lower() == ".png":
            write_figure(draw_futures(futures), output)
        else:
            write_pictures(film_futures(futures), output, frame_rate=1 / scene.dt)
    left = f"; left out: {describe_left_out(futures.left_out)}" if futures.left_out else ""
    console.print(
        f"{output}: {samples} futures of {horizon * model.config.dt:g} s after "
        f"{futures.time:g} s, {int(futures.mark_predicted().sum())} agents{left}"
    )
    if told:
        console.print(told)


DEFAULT_SAMPLES = 10  # as in the paper's figures


@take_scene_files
def compare(
    maps: Annotated[
        list[Path], typer.Argument(help="maps of one place: AIMs, or HD maps as draw writes them")
    ],
    output: Annotated[Path, options.output(".png to write")],
    tracks: options.SceneTracks = None,
    kind: options.Kind = "vehicles",
    weights: Annotated[
        list[Path] | None,
        typer.Option(help="model.pt; once for all maps, or once for each in their order"),
    ] = None,
    ego: Annotated[
        list[str] | None,
        typer.Option(help="id of an agent to show, may be repeated; all agents if omitted"),
    ] = None,
    start: Annotated[
        float | None, typer.Option(help="last observed time, s; the end of the tracks if omitted")
    ] = None,
    history: Annotated[int, typer.Option(help="observed steps", min=1)] = MAX_HISTORY_STEPS,
    duration: Annotated[
        list[float] | None,
        typer.Option(help="predicted time, s; may be repeated, for a row each", min=0.1),
    ] = None,
    samples: options.Samples = DEFAULT_SAMPLES,
    seed: options.Seed = 0,
    *,
    files: SceneFiles,
) -> None:
    """Draw futures on several maps of a place: a column for each map, a row for each duration.

    All panels show the same ground, the sampled futures, and in white what was recorded.

    Example: geoaim compare map.tif hdmap.tif --tracks samples/tracks.csv --ego 5 --start 10
    --history 1 --duration 4 --duration 12 -o figure.png
    """
    from geoaim.base.files import write_figure
    from geoaim.prediction.pictures import draw_panels

    with show_progress() as progress, report_errors():
        check_output(output, (".png",), [*maps, tracks, *(weights or [])])
        choices = _Choices(start, history, duration or [None], samples, seed)
        pairs = _pair_weights(maps, weights or [None])
        columns = []
        for number, (path, file) in enumerate(pairs):
            progress("predict", number, len(pairs))
            column = _predict(SceneSource(path, tracks, **files), load_model(file, kind), choices)
            columns.append([one.select(ego) if ego else one for one in column])
        progress("predict", len(pairs), len(pairs))
        titles = [path.stem if file is None else f"{path.stem}, {file}" for path, file in pairs]
        write_figure(draw_panels(list(zip(*columns, strict=True)), titles), output)
    console.print(f"{output}: {samples} futures on {len(maps)} maps")


@dataclass(frozen=True)
class _Choices:
    """What is predicted on each map, by options."""

    start: float | None
    history: int
    durations: list[float] | list[None]
    samples: int
    seed: int


def _predict(source: SceneSource, model: "ITRA", choices: _Choices) -> list["Futures"]:
    """Predict futures of each duration."""
    import torch

    from geoaim.prediction.predict import predict
    from geoaim.rendering.scene import find_step, slice_scene

    scene, _, _ = read_scene(source, rate=1 / model.config.dt)
    last = find_step(scene, choices.start)
    first = max(0, last + 1 - choices.history)
    return [
        predict(
            model,
            slice_scene(scene, slice(first, None)),
            samples=choices.samples,
            horizon=get_horizon(model, duration),
            start=last - first,
            generator=torch.Generator().manual_seed(choices.seed),
        )
        for duration in choices.durations
    ]


def _pair_weights(
    maps: list[Path], weights: list[Path] | list[None]
) -> list[tuple[Path, Path | None]]:
    """Pair each map with a model."""
    if len(weights) not in (1, len(maps)):
        raise ValueError(
            f"{len(weights)} --weights for {len(maps)} maps; give one, or one for each map"
        )
    return list(zip(maps, weights * (len(maps) // len(weights)), strict=True))
