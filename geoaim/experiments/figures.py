"""Sampled futures side by side: what a model of each kind thinks on each map of a new place."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

from geoaim.experiments.learning import SAMPLES
from geoaim.experiments.models import RECIPES
from geoaim.experiments.places import read_map, read_recordings, scene_of
from geoaim.files import write_figure
from geoaim.prediction.itra import ITRA
from geoaim.prediction.lessons import STEPS
from geoaim.prediction.pictures import draw_futures
from geoaim.prediction.predict import OBSERVED, predict
from geoaim.simulation.scene import scene_steps, step_at_time

TIME = 60.0  # s of the recording after which futures are drawn


def write_futures_on_maps(models: Mapping[str, ITRA], place: Path, path: Path) -> None:
    """Draw a panel for each of `RECIPES` by name, on its map of a place."""
    figure = Figure(figsize=(14, 5.2 * len(models) / 2), layout="constrained")
    recorded = read_recordings(place)[0]
    rows = figure.subplots(-(-len(models) // 2), 2, squeeze=False)
    for axes, (name, model) in zip(rows.flat, models.items(), strict=False):
        recipe = RECIPES[name]
        scene = scene_of(recorded, read_map(place, recipe.map), rate=1 / model.config.seconds)
        steps = STEPS[model.config.kind] - OBSERVED
        start = step_at_time(scene, TIME)
        generator = torch.Generator().manual_seed(0)
        futures = predict(
            model, scene, samples=SAMPLES, steps=steps, start=start, generator=generator
        )
        known = scene_steps(scene, slice(0, start + 1 + steps))
        axes.imshow(np.asarray(draw_futures(known, futures, start)))
        axes.set_title(f"{model.config.kind}s, {recipe.map.upper()}, {place.name}")
        axes.axis("off")
    write_figure(figure, path)
