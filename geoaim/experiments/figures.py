"""Sampled futures side by side: what a model of each kind thinks on each map of new places."""

from collections.abc import Mapping
from pathlib import Path

import torch
from matplotlib.figure import Figure

from geoaim.experiments.learning import SAMPLES
from geoaim.experiments.models import RECIPES
from geoaim.experiments.places import read_map, read_recordings, scene_of
from geoaim.files import write_figure
from geoaim.prediction.itra import ITRA
from geoaim.prediction.lessons import STEPS
from geoaim.prediction.pictures import all_futures, draw_futures
from geoaim.prediction.predict import OBSERVED, predict
from geoaim.simulation.scene import step_at_time

HIGH = 5.2  # inches of a picture


def write_futures_on_maps(models: Mapping[str, ITRA], place: Path, time: float, path: Path) -> None:
    """Draw a panel for each of `RECIPES` by name, all of the same ground: its model on its map.

    Args:
        models: by name.
        place: a made place.
        time: s of its first recording after which futures are drawn.
        path: of the picture.
    """
    recorded, seen = read_recordings(place)[0], None
    panels = []
    for name, model in models.items():
        recipe = RECIPES[name]
        rate = 1 / model.config.seconds
        scene = scene_of(recorded, read_map(place, recipe.map), rate=rate, lights=recipe.lights)
        steps, start = STEPS[model.config.kind] - OBSERVED, step_at_time(scene, time)
        generator = torch.Generator().manual_seed(0)
        futures = predict(
            model, scene, samples=SAMPLES, steps=steps, start=start, generator=generator
        )
        seen = seen or all_futures(scene, futures, start)
        title = f"{model.config.kind}s, {recipe.map.upper()}, {place.name}"
        panels.append((title, draw_futures(scene, futures, start, seen)))
    wide = sum(picture.shape[1] / picture.shape[0] for _, picture in panels)
    figure = Figure(figsize=(HIGH * wide, HIGH), layout="constrained")
    rows = figure.subplots(1, len(panels), squeeze=False)
    for axes, (title, picture) in zip(rows.flat, panels, strict=True):
        axes.imshow(picture)
        axes.axis("off")
        axes.set_title(title)
    write_figure(figure, path)
