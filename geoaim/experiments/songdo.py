"""Real vehicles: models of made places on Songdo's traffic, as they are and fine-tuned."""

from pathlib import Path

import numpy as np

from geoaim.bench.data import require_data
from geoaim.experiments.learning import SAMPLES, VEHICLES
from geoaim.experiments.models import kept_or_trained, trained
from geoaim.experiments.results import differences, write_results
from geoaim.imagery.mosaic import read_imagery
from geoaim.prediction.atlas import make_atlas
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.evaluation import Asked, evaluate
from geoaim.prediction.lessons import STEPS, Lessons
from geoaim.prediction.predict import OBSERVED
from geoaim.prediction.segments import cut_segments, pick, shifted
from geoaim.prediction.training import fine_tuning
from geoaim.progress import Progress
from geoaim.simulation.scene import Scene, make_scene
from geoaim.track_changes import resample_tracks
from geoaim.track_formats import read_geotrax

MARGIN = 30.0  # m of the map around the tracks
TUNING = fine_tuning("vehicle", steps=100, batch=32)


def run(folder: Path, report: Progress) -> list[Path]:
    """real vehicles of Songdo Traffic on an orthophoto, zero-shot and fine-tuned."""
    scene = _scene()
    model = trained("vehicle_aim", folder, report=report)
    ground, offsets = make_atlas([scene.ground], VEHICLES.view)
    every = cut_segments(scene, "vehicle", steps=STEPS["vehicle"], stride=len(scene.times))
    every = shifted(every, offsets[0])
    # five seconds leave no later time to hold out: every other vehicle is learnt from
    learnt, others = pick(every, slice(0, None, 2)), pick(every, slice(1, None, 2))
    lessons = Lessons(learnt, others, ground)
    where = folder / "models" / "vehicle_songdo"
    tuned = kept_or_trained(where, model.config, TUNING, lambda: lessons, report, start=model)
    asked = Asked(OBSERVED, SAMPLES)
    models = {"zero-shot": model, "fine-tuned": tuned} | {name: name for name in BASELINES}
    found = {}
    for name, who in models.items():
        found[name] = evaluate(who, others, ground, asked, report=report)
    tuning = differences(found["fine-tuned"], found["zero-shot"])
    about = {"vehicles": len(others), "fine-tuned less zero-shot": tuning}
    return write_results("songdo", found, about)


def _scene() -> Scene:
    given = require_data("tracks/songdo_u")
    tracks = read_geotrax(given / "U_video_cut.csv", crs="EPSG:5186")
    tracks = resample_tracks(tracks, 1 / VEHICLES.seconds)
    places = tracks.states[tracks.present][:, :2]
    corners = np.stack([places.min(axis=0) - MARGIN, places.max(axis=0) + MARGIN])
    path = given / "ortho_U_25cm_epsg5186.tif"
    return make_scene(read_imagery(path, world=tracks.world, corners=corners), tracks)
