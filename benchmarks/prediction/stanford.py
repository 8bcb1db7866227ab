"""Real pedestrians: windows of the Stanford Drone Dataset."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from benchmarks.data import require_data
from benchmarks.prediction.averages import average_seeds
from benchmarks.prediction.models import train_once
from benchmarks.prediction.places import add_blur_and_noise
from benchmarks.prediction.results import Metrics, Workspace, compute_differences, write_results
from benchmarks.prediction.windows import (
    WINDOW_TRAINING,
    WITH_MAP,
    WITHOUT_MAP,
    ImageTransform,
    WindowFiles,
    Windows,
    evaluate_windows,
    make_window_predictor,
    make_windows_dataset,
    read_windows,
)
from geoaim.base.progress import Progress
from geoaim.prediction.baselines import BASELINES, NOISY, Predictor
from geoaim.prediction.config import Config
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import Metric
from geoaim.prediction.training import init_model

DATA = "tracks/sdd_trajnet"
VAL_SCENES = ("bookstore_3", "coupa_3", "deathCircle_3", "gates_1", "hyang_6", "nexus_8")
STANFORD_SAMPLES = 20
MODELS = {
    "map": WITH_MAP,
    "no map": WITHOUT_MAP,
    "no map, no proposals": replace(WITHOUT_MAP, num_anchors=0, history=0, horizon=0),
}
SEEDS = {"map": 3, "no map": 3}  # seeds differ as much as maps help; other models have one
PAIRS = (("map", "no map"), ("map, blurred and noisy", "map"), ("no map", "no map, no proposals"))


def run(workspace: Workspace) -> list[Path]:
    """Evaluate real pedestrians of the Stanford Drone Dataset, 20 samples; return the files."""
    names = [path.stem for path in sorted((require_data(DATA) / "windows").glob("*.csv"))]
    train_scenes = [name for name in names if name not in VAL_SCENES]
    metrics: dict[str, Metrics] = {}
    for name, config in MODELS.items():
        predictors = [
            make_window_predictor(
                train_on_scenes(name, train_scenes, workspace, seed=seed), STANFORD_SAMPLES
            )
            for seed in range(SEEDS.get(name, 1))
        ]
        val = read_scenes(config, VAL_SCENES)
        metrics[name] = _evaluate(predictors, val, workspace.progress)
        if name == "map":
            degraded = read_scenes(config, VAL_SCENES, transform=_degrade)
            metrics["map, blurred and noisy"] = _evaluate(predictors, degraded, workspace.progress)
    for name in ("constant velocity", NOISY):  # headings are not measured
        metrics[name] = _evaluate([BASELINES[name]], val, workspace.progress)
    train_on_scenes("map", names, workspace, label="all scenes")
    return write_results("stanford", metrics, _describe(metrics, val), workspace.results)


def _evaluate(
    predictors: Sequence[Predictor], windows: Windows, progress: Progress
) -> dict[str, Metric]:
    return average_seeds(
        [
            evaluate_windows(predictor, windows, STANFORD_SAMPLES, progress=progress)
            for predictor in predictors
        ]
    )


def _describe(metrics: Mapping[str, Metrics], windows: Windows) -> dict[str, Any]:
    return {
        "windows": len(windows.segments),
        "scenes": VAL_SCENES,
        "samples": STANFORD_SAMPLES,
        "seeds": SEEDS,
        "differences": {
            f"{one} minus {other}": compute_differences(metrics[one], metrics[other])
            for one, other in PAIRS
        },
        "by scene": {
            name: {scene: _average_scene(scene, metrics[name], windows) for scene in VAL_SCENES}
            for name in SEEDS
        },
    }


def train_on_scenes(
    name: str,
    scenes: Sequence[str],
    workspace: Workspace,
    *,
    seed: int = 0,
    label: str | None = None,
) -> ITRA:
    """Train one of `MODELS` on windows of some scenes, forwards and reversed.

    Args:
        name: name of the model.
        scenes: names of the scenes.
        workspace: keeps the folder.
        seed: seed of the training.
        label: name of the folder; None: that of the model.

    Returns:
        The model.
    """
    config = MODELS[name]

    def load_dataset() -> Dataset:
        return make_windows_dataset(_list_files(config), config, scenes=scenes)

    words = (label or name).replace(",", "").split()
    model, training = init_model(config, seed=seed), replace(WINDOW_TRAINING, seed=seed)
    return train_once(model, training, load_dataset, "_".join(["stanford", *words]), workspace)


def _average_scene(scene: str, metrics: Metrics, windows: Windows) -> dict[str, float]:
    here = np.array(windows.scenes) == scene
    return {name: Metric(m.sums[here], m.counts[here]).mean for name, m in metrics.items()}


def read_scenes(
    config: Config, scenes: Sequence[str], transform: ImageTransform | None = None
) -> Windows:
    """Read the windows of some scenes.

    Args:
        config: configuration of the model that is to read them.
        scenes: names of the scenes.
        transform: changes the scenes' images; None: nothing.

    Returns:
        The windows.
    """
    return read_windows(_list_files(config), config.view, scenes=scenes, transform=transform)


def _list_files(config: Config) -> WindowFiles:
    folder = require_data(DATA)
    images = folder / "images" if config.use_observations else None
    return WindowFiles(folder / "windows", images, folder / "scenes.csv")


def _degrade(image: Float32[Array, "H W 3"], resolution: float) -> Float32[Array, "H W 3"]:
    """Add blur and noise at the resolution of the view."""
    return add_blur_and_noise(image, WITH_MAP.resolution / resolution)
