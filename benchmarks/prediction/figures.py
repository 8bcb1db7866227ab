"""Figures: sampled futures of several models side by side, each on the map it is trained on."""

from collections.abc import Mapping
from pathlib import Path

import torch
from matplotlib.figure import Figure

from benchmarks.prediction.models import MODELS
from benchmarks.prediction.places import make_place_scene, read_map, read_recordings
from geoaim.base.defaults import SAMPLES
from geoaim.prediction.config import MAX_HISTORY_STEPS, SEGMENT_STEPS
from geoaim.prediction.itra import ITRA
from geoaim.prediction.predict import predict
from geoaim.rendering.scene import find_step

HEIGHT_INCHES = 5.2


def draw_futures_on_maps(models: Mapping[str, ITRA], place: Path, time: float) -> Figure:
    """Draw the same ground in a panel for each model.

    Args:
        models: models, by their names in `MODELS`.
        place: folder of a synthetic place.
        time: s of its first recording after which futures begin.

    Returns:
        The figure.
    """
    recording, limits = read_recordings(place)[0], dict[str, tuple[float, float]]()
    figure = Figure(
        figsize=(HEIGHT_INCHES * 1.4 * len(models), HEIGHT_INCHES), layout="constrained"
    )
    panels = figure.subplots(1, len(models), squeeze=False).flat
    for axes, (name, model) in zip(panels, models.items(), strict=True):
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
        futures.plot(axes).set_title(f"{kind}s, {spec.map_name.upper()}, {place.name}")
        limits = limits or {"xlim": axes.get_xlim(), "ylim": axes.get_ylim()}
        axes.set(**limits)
    return figure
