"""Figures: sampled futures of several models side by side, each on the map it is trained on."""

from collections.abc import Mapping
from pathlib import Path

import torch
from matplotlib.figure import Figure

from geoaim.experiments.models import MODELS
from geoaim.experiments.places import make_place_scene, read_map, read_recordings
from geoaim.experiments.protocol import SAMPLES
from geoaim.prediction.config import MAX_HISTORY_STEPS, SEGMENT_STEPS
from geoaim.prediction.itra import ITRA
from geoaim.prediction.pictures import draw_futures, fit_camera
from geoaim.prediction.predict import predict
from geoaim.simulation.scene import find_step

HEIGHT_INCHES = 5.2


def draw_futures_on_maps(models: Mapping[str, ITRA], place: Path, time: float) -> Figure:
    """Draw the same ground in a panel for each model.

    Args:
        models: by their names in `MODELS`.
        place: folder of a synthetic place.
        time: s of its first recording after which futures begin.

    Returns:
        The figure.
    """
    recording, camera = read_recordings(place)[0], None
    panels = []
    for name, model in models.items():
        spec, kind = MODELS[name], model.config.kind
        aim = read_map(place, spec.map_name)
        scene = make_place_scene(recording, aim, dt=model.config.dt, lights=spec.lights)
        start = find_step(scene, time)
        futures = predict(
            model,
            scene,
            samples=SAMPLES,
            horizon=SEGMENT_STEPS[kind] - MAX_HISTORY_STEPS,
            start=start,
            generator=torch.Generator().manual_seed(0),
        )
        camera = camera or fit_camera(scene, futures, start)
        title = f"{kind}s, {spec.map_name.upper()}, {place.name}"
        panels.append((title, draw_futures(scene, futures, start, camera)))
    aspect = sum(picture.shape[1] / picture.shape[0] for _, picture in panels)
    figure = Figure(figsize=(HEIGHT_INCHES * aspect, HEIGHT_INCHES), layout="constrained")
    axes_row = figure.subplots(1, len(panels), squeeze=False)
    for axes, (title, picture) in zip(axes_row.flat, panels, strict=True):
        axes.imshow(picture)
        axes.axis("off")
        axes.set_title(title)
    return figure
