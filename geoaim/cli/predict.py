"""The command that predicts the futures of agents."""

from pathlib import Path
from typing import Annotated

import typer

from geoaim.base.defaults import SAMPLES
from geoaim.cli import options
from geoaim.cli.console import console, report_errors, show_progress
from geoaim.cli.inputs import get_horizon, load_model, read_scene
from geoaim.cli.outputs import check_output
from geoaim.cli.scene_options import SceneFiles, take_scene_files


@take_scene_files
def predict(
    aim: options.AimFile,
    tracks: options.TracksFile,
    output: Annotated[Path, options.output(".csv, .png, .mp4 or .gif to write")],
    kind: options.Kind = "vehicles",
    weights: options.WeightsFile = None,
    at: Annotated[
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

    All other agents keep their speed and heading. A .csv has a row for each sample, agent and time.
    Pictures show all samples on the map, and in white the recorded future, if there is one after
    --at.

    Example: geoaim predict map.tif --tracks samples/tracks.csv --at 20 -o futures.png
    """
    import torch

    from geoaim.base.files import write_figure
    from geoaim.prediction.pictures import draw_futures, film_futures, write_futures
    from geoaim.prediction.predict import predict as predict_futures
    from geoaim.rendering.pictures import write_pictures
    from geoaim.rendering.scene import find_step
    from geoaim.tracks.agent_types import select_group

    with show_progress() as progress, report_errors():
        inputs = [aim, tracks, files.lights, files.hdmap]
        check_output(output, (".csv", ".png", ".mp4", ".gif"), inputs)
        model = load_model(weights, kind)
        source = files.make_source(aim, tracks)
        scene, _, world = read_scene(source, rate=1 / model.config.dt)
        start, horizon = find_step(scene, at), get_horizon(model, duration)
        progress("predict", 0, 1)
        futures = predict_futures(
            model,
            scene,
            samples=samples,
            horizon=horizon,
            start=start,
            generator=torch.Generator().manual_seed(seed),
        )
        progress("predict", 1, 1)
        if output.suffix.lower() == ".csv":
            write_futures(futures, output, world=world)
        elif output.suffix.lower() == ".png":
            write_figure(draw_futures(futures), output)
        else:
            write_pictures(film_futures(futures), output, frame_rate=1 / scene.dt)
    known = torch.isfinite(futures.states[0, :, 0, 0])
    of_kind = select_group(scene.types, model.config.kind)
    predicted = int((of_kind & known.cpu().numpy()).sum())
    console.print(
        f"{output}: {samples} futures of {horizon * model.config.dt:g} s after "
        f"{float(scene.times[start]):g} s, {predicted} agents"
    )
