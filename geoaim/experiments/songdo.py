"""Real vehicles of the Songdo Traffic dataset: zero-shot and fine-tuned models."""

from pathlib import Path

import numpy as np

from geoaim.bench.data import require_data
from geoaim.defaults import SAMPLES
from geoaim.experiments.models import train_model, train_once
from geoaim.experiments.protocol import VEHICLES
from geoaim.experiments.results import Workspace, compute_differences, write_results
from geoaim.imagery.mosaic import read_imagery
from geoaim.prediction.atlas import make_atlas
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.config import MAX_HISTORY_STEPS, SEGMENT_STEPS, configure_fine_tuning
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.evaluation import EvalConfig, evaluate
from geoaim.prediction.segments import pick, shift
from geoaim.simulation.scene import Scene, make_scene
from geoaim.track_changes import resample_tracks
from geoaim.track_formats import read_geotrax

DATA = "tracks/songdo_u"
MARGIN_M = 30.0  # of the map around the tracks
FINE_TUNING = configure_fine_tuning("vehicle", steps=100, batch_size=32)


def run(workspace: Workspace) -> list[Path]:
    """Evaluate real vehicles of Songdo Traffic, zero-shot and fine-tuned; return the files."""
    dataset = _make_songdo_dataset(read_scene())
    model = train_model("vehicle_aim", workspace)
    tuned = train_once(model, FINE_TUNING, lambda: dataset, "vehicle_songdo", workspace)
    options = EvalConfig(MAX_HISTORY_STEPS, SAMPLES)
    predictors = {"zero-shot": model.sample, "fine-tuned": tuned.sample, **BASELINES}
    metrics = {
        name: evaluate(predictor, dataset.val, dataset.ground, options, progress=workspace.progress)
        for name, predictor in predictors.items()
    }
    difference = compute_differences(metrics["fine-tuned"], metrics["zero-shot"])
    settings = {"vehicles": len(dataset.val), "fine-tuned minus zero-shot": difference}
    return write_results("songdo", metrics, settings, workspace.results)


def _make_songdo_dataset(scene: Scene) -> Dataset:
    """Split a recording by vehicles, as it is too short to be split by time."""
    ground, offsets = make_atlas([scene.ground], VEHICLES.view)
    steps, stride = SEGMENT_STEPS["vehicle"], len(scene.times)
    segments = shift(cut_segments(scene, "vehicle", steps=steps, stride=stride), offsets[0])
    train, val = pick(segments, slice(0, None, 2)), pick(segments, slice(1, None, 2))
    return Dataset(train, val, ground)


def read_scene() -> Scene:
    """Read the recording of five seconds, on an orthophoto.

    Raises:
        TracksError: the data are missing.
    """
    folder = require_data(DATA)
    tracks = read_geotrax(folder / "U_video_cut.csv", crs="EPSG:5186")
    tracks = resample_tracks(tracks, 1 / VEHICLES.dt)
    positions = tracks.states[tracks.present][:, :2]
    corners = np.stack([positions.min(axis=0) - MARGIN_M, positions.max(axis=0) + MARGIN_M])
    path = folder / "ortho_U_25cm_epsg5186.tif"
    return make_scene(read_imagery(path, world=tracks.world, corners=corners), tracks)
