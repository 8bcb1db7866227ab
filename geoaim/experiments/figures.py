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
from geoaim.prediction.pictures import draw_futures
from geoaim.prediction.predict import OBSERVED, predict
from geoaim.simulation.scene import step_at_time

TIME = 60.0  # s of the recording after which futures are drawn


def write_futures_on_maps(panels: Mapping[str, tuple[ITRA, Path]], path: Path) -> None:
    """Draw a panel for each of `RECIPES` by name: its model on its map of a place."""
    figure = Figure(figsize=(14, 5.2 * len(panels) / 2), layout="constrained")
    rows = figure.subplots(-(-len(panels) // 2), 2, squeeze=False)
    for axes in rows.flat:
        axes.axis("off")
    for axes, (name, (model, place)) in zip(rows.flat, panels.items(), strict=False):
        recipe, recorded = RECIPES[name], read_recordings(place)[0]
        rate = 1 / model.config.seconds
        scene = scene_of(recorded, read_map(place, recipe.map), rate=rate, lights=recipe.lights)
        steps = STEPS[model.config.kind] - OBSERVED
        start = step_at_time(scene, TIME)
        generator = torch.Generator().manual_seed(0)
        futures = predict(
            model, scene, samples=SAMPLES, steps=steps, start=start, generator=generator
        )
        axes.imshow(draw_futures(scene, futures, start))
        axes.set_title(f"{model.config.kind}s, {recipe.map.upper()}, {place.name}")
    write_figure(figure, path)
