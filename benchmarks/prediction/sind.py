"""Real pedestrians of the SinD dataset, on HD maps and on drone images of its junctions.

The dataset does not tell where its images lie. Control points were picked by hand, in files beside
this one: ends of stop lines and corners of crosswalks, which the HD map has too.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.data import read_image, require_data
from benchmarks.prediction import results
from benchmarks.prediction.averages import average_seeds
from benchmarks.prediction.models import train_all_seeds, train_once
from benchmarks.prediction.protocol import PEDESTRIANS, evaluate_scene
from geoaim.aim.aim import AIM
from geoaim.hdmap.lanelet2 import HDMap, read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.mapping.georeference.control_points import read_control_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.prediction.baselines import BASELINES, Predictor
from geoaim.prediction.config import SEGMENT_STEPS, configure_fine_tuning
from geoaim.prediction.dataset import make_dataset, split_scene
from geoaim.prediction.metrics import Metric, concat
from geoaim.rendering.scene import Scene, make_scene
from geoaim.tracks.changes import resample_tracks
from geoaim.tracks.formats import read_tracks

# files of each junction: its HD map and its pedestrians
JUNCTIONS = {
    "Chongqing": ("NR_ll2.osm", "6_22_NR_1/Ped_smoothed_tracks.csv"),
    "Changchun": ("Changchun_Pudong.osm", "changchun_pudong_507_009/Ped_smoothed_tracks.csv"),
}
DATA = "tracks/sind"
MAPS = ("aim", "hdm")
VAL_FRACTION = 0.5
FINE_TUNING = configure_fine_tuning("pedestrian", steps=150, batch_size=48)


def run(workspace: results.Workspace) -> list[Path]:
    """Evaluate SinD's pedestrians on HD maps and images, zero-shot and fine-tuned; return files."""
    junctions = {name: georeference_junction(name) for name in JUNCTIONS}
    metrics: dict[str, results.Metrics] = {}
    by_seed: dict[str, list[dict[str, float]]] = {}
    for map_name in MAPS:
        scenes = [
            _make_scene(name, aim if map_name == "aim" else draw_hdmap(hdmap))
            for name, (aim, _, hdmap) in junctions.items()
        ]
        predictors = _train(map_name, scenes, workspace)
        if map_name == MAPS[-1]:
            predictors |= {name: [predictor] for name, predictor in BASELINES.items()}
        for number, (name, seeds) in enumerate(predictors.items()):
            workspace.progress(f"evaluate {map_name}", number, len(predictors))
            parts = [_evaluate(predictor, scenes) for predictor in seeds]
            metrics[name] = average_seeds(parts)
            if len(parts) > 1:
                by_seed[name] = results.compute_seed_means(parts)
    settings = {
        "trained on": "first halves of both recordings",
        "evaluated on": "second halves, all pedestrians of each 12 s jointly; no vehicle tracks",
        "segments": len(metrics["constant velocity"]["minADE"].sums),
        "pedestrians": int(metrics["constant velocity"]["minADE"].counts.sum()),
        "georeference": {name: _summarise_fit(fit) for name, (_, fit, _) in junctions.items()},
        "by seed": by_seed,
    }
    for stage in ("zero-shot", "fine-tuned"):
        difference = results.compute_differences(metrics[f"aim, {stage}"], metrics[f"hdm, {stage}"])
        settings[f"aim minus hdm, {stage}"] = difference
    return results.write_results("sind", metrics, settings, workspace.results)


def georeference_junction(name: str) -> tuple[AIM, Georeference, HDMap]:
    """Georeference the image of one of `JUNCTIONS` by its control points, in metres of its HD map.

    Returns:
        The image as an AIM, its fit, and the HD map.

    Raises:
        TracksError: the data are missing.
    """
    folder = require_data(DATA) / name
    hdmap_name, _ = JUNCTIONS[name]
    hdmap = read_hdmap(folder / hdmap_name)
    image = read_image(folder / "frame_4k.jpg")
    points = read_control_points(Path(__file__).with_name(f"sind_{name.lower()}.csv"), crs="local")
    height, width = image.shape[:2]
    fit = estimate_georeference(points, height=height, width=width, world=hdmap.world)
    return AIM.from_image(image, fit.world_from_image, hdmap.world, "SinD"), fit, hdmap


def read_scenes() -> list[Scene]:
    """Read the pedestrians of all junctions, on the images.

    Raises:
        TracksError: the data are missing.
    """
    return [_make_scene(name, georeference_junction(name)[0]) for name in JUNCTIONS]


def _make_scene(name: str, aim: AIM) -> Scene:
    _, tracks_name = JUNCTIONS[name]
    tracks = read_tracks(require_data(DATA) / name / tracks_name, world=aim.world)
    return make_scene(aim, resample_tracks(tracks, 1 / PEDESTRIANS.dt))


def _train(
    map_name: str, scenes: list[Scene], workspace: results.Workspace
) -> dict[str, list[Predictor]]:
    """Predictors on a map, of each seed: trained on synthetic places, and fine-tuned."""
    load_dataset = partial(make_dataset, scenes, PEDESTRIANS, val_fraction=VAL_FRACTION)
    zero_shot: list[Predictor] = []
    fine_tuned: list[Predictor] = []
    models = train_all_seeds(f"pedestrian_{map_name}", workspace)
    for seed, model in enumerate(models):
        training, name = replace(FINE_TUNING, seed=seed), f"pedestrian_sind_{map_name}"
        tuned = train_once(model, training, load_dataset, name, workspace)
        zero_shot.append(model.sample)
        fine_tuned.append(tuned.sample)
    return {f"{map_name}, zero-shot": zero_shot, f"{map_name}, fine-tuned": fine_tuned}


def _evaluate(predictor: Predictor, scenes: list[Scene]) -> dict[str, Metric]:
    parts = []
    for scene in scenes:
        _, val = split_scene(scene, VAL_FRACTION)
        stride = SEGMENT_STEPS[PEDESTRIANS.kind]
        parts += evaluate_scene(predictor, val, PEDESTRIANS, stride=stride)
    return concat(parts)


def _summarise_fit(fit: Georeference) -> Mapping[str, Any]:
    rms = math.sqrt(float((fit.residuals**2).sum(axis=1).mean()))
    return {"model": fit.model, "points": len(fit.residuals), "rms of residuals, m": rms}
