"""Real pedestrians: the Stanford Drone Dataset's windows, with published numbers beside ours."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from geoaim.bench.data import require_data
from geoaim.experiments.models import kept_or_trained, training_folder
from geoaim.experiments.places import blurred_and_noisy
from geoaim.experiments.results import Measures, differences, write_results
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.evaluation import evaluate_windows
from geoaim.prediction.itra import ITRA, Config
from geoaim.prediction.lessons import Lessons
from geoaim.prediction.metrics import Measure, pooled
from geoaim.prediction.segments import joined
from geoaim.prediction.training import Training
from geoaim.prediction.windows import (
    OBSERVED,
    SECONDS,
    STEPS,
    Change,
    Windows,
    backwards,
    read_windows,
    unchanged,
)
from geoaim.progress import Progress

DATA = "tracks/sdd_trajnet"
VALIDATION = ("bookstore_3", "coupa_3", "deathCircle_3", "gates_1", "hyang_6", "nexus_8")
SAMPLES = 20
SEES = Config(
    "pedestrian",
    "slide",
    SECONDS,
    size=32,
    resolution=1.5,
    every=12,
    modes=20,
    known=OBSERVED,
    ahead=STEPS - OBSERVED,
    unlike=True,
)
MODELS = {
    "map": SEES,
    "no map": replace(SEES, unlike=False, encoder="none"),
    "no map, no plans": replace(SEES, unlike=False, encoder="none", modes=0, known=0, ahead=0),
}
TRAINING = Training(
    steps=4000,
    batch=128,
    divergence=1.2,
    warm_up=0.0,
    observed=(OBSERVED, OBSERVED),
    mirror=True,
    resize=0.2,
    colour=0.2,
)
# trainings: chance is as large as what maps give; the others have one
REPEATED = {"map": 3, "no map": 3}
BEST = "map"  # learns from all scenes as well
PAIRS = (
    ("map", "no map"),
    ("map, blurred and noisy", "map"),
    ("no map", "no map, no plans"),
)
# minADE and minFDE of 20 on the standard test part, pixels, as their authors or later papers say
PUBLISHED = {
    "S-GAN": (27.23, 41.44),
    "Trajectron++": (19.30, 32.70),
    "constant velocity with noise": (12.11, 21.73),
    "PECNet": (9.96, 15.88),
    "Y-net": (7.85, 11.85),
    "NSP-SFM": (6.52, 10.61),
    "MUSE-VAE": (6.36, 11.10),
}


def run(folder: Path, report: Progress) -> list[Path]:
    """real pedestrians of the Stanford Drone Dataset, minADE and minFDE of 20."""
    given = require_data(DATA)
    names = [path.stem for path in sorted((given / "windows").glob("*.csv"))]
    rest = [name for name in names if name not in VALIDATION]
    found: dict[str, Measures] = {}
    for name, config in MODELS.items():
        models = [
            _trained(name, config, rest, folder, report, seed=seed)
            for seed in range(REPEATED.get(name, 1))
        ]
        valid = _windows(given, config, VALIDATION)
        found[name] = _judged(models, valid, report)
        if name == "map":
            worse = _windows(given, config, VALIDATION, change=_degraded)
            found["map, blurred and noisy"] = _judged(models, worse, report)
    for who in BASELINES[:2]:  # headings that are not known do not turn
        found[who] = _judged([who], valid, report)
    _trained("all scenes", MODELS[BEST], names, folder, report)
    return write_results("stanford", found, _about(found, valid))


def _judged(models: Sequence[ITRA | str], windows: Windows, report: Progress) -> dict[str, Measure]:
    return pooled([evaluate_windows(model, windows, SAMPLES, report=report) for model in models])


def _about(found: Mapping[str, Measures], windows: Windows) -> dict[str, Any]:
    return {
        "windows": len(windows.segments),
        "scenes": VALIDATION,
        "samples": SAMPLES,
        "trainings, where more than one": REPEATED,
        "published on the standard test part, not on these scenes": PUBLISHED,
        "differences": {
            f"{one}, less {other}": differences(found[one], found[other]) for one, other in PAIRS
        },
        "by scene": {
            name: {scene: _means_in(scene, found[name], windows) for scene in VALIDATION}
            for name in REPEATED
        },
    }


def _trained(
    name: str,
    config: Config,
    scenes: list[str],
    folder: Path,
    report: Progress,
    *,
    seed: int = 0,
) -> ITRA:
    def lessons() -> Lessons:
        windows = _windows(require_data(DATA), config, scenes)
        both = joined([windows.segments, backwards(windows.segments)])
        # the log follows windows that are learnt; those of other scenes are judged afterwards
        return Lessons(both, windows.segments, windows.ground)

    label = "_".join(["stanford", *name.replace(",", "").split()])
    training = replace(TRAINING, seed=seed)
    where = training_folder(folder, label, seed)
    return kept_or_trained(where, config, training, lessons, report)


def _means_in(scene: str, found: Measures, windows: Windows) -> dict[str, float]:
    here = np.array(windows.scenes) == scene
    return {name: Measure(m.sums[here], m.counts[here]).mean for name, m in found.items()}


def _windows(
    given: Path, config: Config, scenes: Sequence[str], change: Change = unchanged
) -> Windows:
    images = None if config.encoder == "none" else given / "images"
    return read_windows(
        given / "windows", images, given / "scenes.csv", config.view, only=scenes, change=change
    )


def _degraded(image: Float32[Array, "H W 3"], resolution: float) -> Float32[Array, "H W 3"]:
    """Blurred and noisy by pixels of the view."""
    return blurred_and_noisy(image, SEES.resolution / resolution)
