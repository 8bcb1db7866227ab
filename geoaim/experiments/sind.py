"""Real pedestrians on an HD map and on a drone's image: SinD's junctions, each map fitted by hand.

The dataset does not say where its images lie. Their pixels below are of what the HD map has as
well: ends of stop lines, corners of crossings.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.bench.data import require_data
from geoaim.errors import TracksError
from geoaim.experiments.learning import PEOPLE, SAMPLES, judged
from geoaim.experiments.models import all_trained, kept_or_trained, training_folder
from geoaim.experiments.results import Measures, differences, means, write_results
from geoaim.hdmap.lanelet2 import HDMap, read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.mapping.georeference.control_points import read_control_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.evaluation import Asked
from geoaim.prediction.itra import ITRA
from geoaim.prediction.lessons import STEPS, make_lessons, split
from geoaim.prediction.metrics import Measure, merged, pooled
from geoaim.prediction.predict import OBSERVED
from geoaim.prediction.training import fine_tuning
from geoaim.progress import Progress
from geoaim.simulation.scene import Scene, make_scene
from geoaim.track_changes import resample_tracks
from geoaim.track_formats import read_any


@dataclass(frozen=True)
class Junction:
    """Files of a junction, and places on its image: u, v, pixels, and x, y, metres of its map."""

    hdmap: str
    tracks: str
    places: tuple[tuple[float, float, float, float], ...]


JUNCTIONS = {
    "Chongqing": Junction(
        "NR_ll2.osm",
        "6_22_NR_1/Ped_smoothed_tracks.csv",
        (
            (1601, 720, -8.6, 27.2),  # inner corners of crossings
            (1601, 1422, -8.2, 8.0),
            (2272, 734, 9.9, 27.2),
            (2270, 1432, 10.2, 8.2),
            (1383, 503, -14.6, 33.1),  # outer ones
            (1383, 1630, -14.2, 2.1),
            (2486, 522, 15.8, 33.2),
            (2484, 1649, 16.4, 2.2),
            (1891, 1714, 0.0, 0.0),  # ends of stop lines
            (2545, 1139, 17.7, 16.2),
            (1305, 1047, -16.4, 18.2),
            (1305, 1442, -16.2, 6.7),
            (1954, 433, 1.4, 35.4),
            (1562, 422, -10.3, 35.2),
            (2545, 739, 17.5, 27.7),
        ),
    ),
    "Changchun": Junction(
        "Changchun_Pudong.osm",
        "changchun_pudong_507_009/Ped_smoothed_tracks.csv",
        (
            (1494, 1052, -39.6, -3.7),  # ends of stop lines
            (1496, 1296, -39.2, -13.4),
            (1704, 598, -32.0, 14.3),
            (1934, 598, -21.7, 14.7),
            (2370, 1053, -3.4, -2.3),
            (1931, 1495, -20.4, -20.6),
            (2155, 1494, -10.3, -20.1),
        ),
    ),
}
DATA = "tracks/sind"
MAPS = ("aim", "hdm")
TUNING = fine_tuning("pedestrian", steps=150, batch=48)


def run(folder: Path, report: Progress) -> list[Path]:
    """real pedestrians of SinD on HD maps and on images, zero-shot and fine-tuned."""
    found: dict[str, Measures] = {}
    single: dict[str, list[dict[str, float]]] = {}
    fits = {name: fit(name) for name in JUNCTIONS}
    for kind in MAPS:
        scenes = [
            _scene(name, image if kind == "aim" else draw_hdmap(hdmap))
            for name, (image, _, hdmap) in fits.items()
        ]
        lessons = partial(make_lessons, scenes, PEOPLE, held_out=0.5)
        models: dict[str, list[ITRA | str]] = {f"{kind}, zero-shot": [], f"{kind}, fine-tuned": []}
        for seed, model in enumerate(all_trained(f"pedestrian_{kind}", folder, report=report)):
            where = training_folder(folder, f"pedestrian_sind_{kind}", seed)
            tuning = replace(TUNING, seed=seed)
            tuned = kept_or_trained(where, PEOPLE, tuning, lessons, report, start=model)
            models[f"{kind}, zero-shot"].append(model)
            models[f"{kind}, fine-tuned"].append(tuned)
        if kind == MAPS[-1]:
            models |= {name: [name] for name in BASELINES}
        for number, (name, trainings) in enumerate(models.items()):
            report(f"judge {kind}", number, len(models))
            parts = [_judge(who, scenes) for who in trainings]
            found[name] = pooled(parts)
            if len(parts) > 1:
                single[name] = means(parts)
    gains = {
        f"aim less hdm, {how}": differences(found[f"aim, {how}"], found[f"hdm, {how}"])
        for how in ("zero-shot", "fine-tuned")
    }
    about = {
        "learnt from": "first halves of both recordings",
        "judged on": "second halves, all people of every 12 s jointly; vehicles have no tracks",
        "pieces": len(found["constant velocity"]["minADE"].sums),
        "people in them": int(found["constant velocity"]["minADE"].counts.sum()),
        "georeference": {name: _said(place) for name, (_, place, _) in fits.items()},
        "each training": single,
        **gains,
    }
    return write_results("sind", found, about)


def fit(name: str) -> tuple[AIM, Georeference, HDMap]:
    """A junction's image where its HD map says that it lies.

    Raises:
        TracksError: the data are not here.
    """
    given, junction = require_data(DATA) / name, JUNCTIONS[name]
    hdmap = read_hdmap(given / junction.hdmap)
    image = _read_image(given / "frame_4k.jpg")
    rows = [dict(zip(("u", "v", "x", "y"), row, strict=True)) for row in junction.places]
    points = read_control_points(rows, crs="local")
    height, width = image.shape[:2]
    found = estimate_georeference(points, height=height, width=width, world=hdmap.world)
    return AIM.from_image(image, found.world_from_image, hdmap.world, "SinD"), found, hdmap


def _scene(name: str, aim: AIM) -> Scene:
    """A junction's recording on one of its maps."""
    tracks = read_any(require_data(DATA) / name / JUNCTIONS[name].tracks, world=aim.world)
    return make_scene(aim, resample_tracks(tracks, 1 / PEOPLE.seconds))


def _judge(model: ITRA | str, scenes: list[Scene]) -> dict[str, Measure]:
    parts = []
    for scene in scenes:
        _, half = split(scene, 0.5)
        asked = Asked(OBSERVED, SAMPLES)
        parts += judged(model, half, PEOPLE, asked, stride=STEPS[PEOPLE.kind])
    return merged(parts)


def _said(found: Georeference) -> Mapping[str, Any]:
    rms = math.sqrt(float((found.residuals**2).sum(axis=1).mean()))
    return {"model": found.model, "points": len(found.names), "rms of residuals, m": rms}


def _read_image(path: Path) -> Array:
    image = cv2.imread(str(path))
    if image is None:
        raise TracksError(f"{path} is no image")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
