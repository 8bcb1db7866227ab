"""Real vehicles of the Songdo Traffic dataset: zero-shot and fine-tuned models."""

import math
from pathlib import Path

import numpy as np

from benchmarks.data import require_data
from benchmarks.prediction.averages import merge_segments
from benchmarks.prediction.models import train_once
from benchmarks.prediction.protocol import VEHICLES
from benchmarks.prediction.real_places import RealRecording
from benchmarks.prediction.results import Workspace, write_results
from geoaim.base.defaults import SAMPLES
from geoaim.imagery.mosaic import read_imagery
from geoaim.prediction.baselines import BASELINES, Predictor, replay
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS, SEGMENT_STEPS, configure_fine_tuning
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.dataset import Dataset, stack_maps
from geoaim.prediction.evaluation import EvalConfig, evaluate
from geoaim.prediction.metrics import keep_rates
from geoaim.prediction.segments import pick
from geoaim.rendering.scene import Scene, slice_scene
from geoaim.tracks.formats import read_geotrax
from geoaim.tracks.formats.motion import OBSERVED_WINDOW_S

DATA = "tracks/songdo_u"
MARGIN_M = 30.0  # margin of the map around the tracks
FINE_TUNING = configure_fine_tuning("vehicle", steps=100, batch_size=32)


def run(workspace: Workspace) -> list[Path]:
    """Evaluate real vehicles of Songdo Traffic, zero-shot and fine-tuned; return the files."""
    dataset = make_dataset(read_scene())
    model = read_pretrained("vehicle")
    tuned = train_once(model, FINE_TUNING, lambda: dataset, "vehicle_songdo", workspace)
    options = EvalConfig(MAX_HISTORY_STEPS, SAMPLES)
    predictors: dict[str, Predictor] = {
        "zero-shot": model.sample,
        "fine-tuned": tuned.sample,
        **BASELINES,
    }
    predictors["recording"] = replay
    metrics = {
        name: merge_segments(
            evaluate(predictor, dataset.val, dataset.ground, options, progress=workspace.progress)
        )
        for name, predictor in predictors.items()
    }
    metrics["recording"] = keep_rates(metrics["recording"])
    return write_results("songdo", metrics, {"places": 1}, workspace.results)


def make_dataset(scene: Scene) -> Dataset:
    """Split the recording by vehicles, as it is too short to be split by time."""
    steps, stride = SEGMENT_STEPS["vehicle"], len(scene.times)
    segments = cut_segments(scene, "vehicle", steps=steps, stride=stride)
    train, val = pick(segments, slice(0, None, 2)), pick(segments, slice(1, None, 2))
    return Dataset(train, val, stack_maps([scene.ground], VEHICLES.view))


def read_scene() -> Scene:
    """Read the recording on an orthophoto, from the step on at which speeds are known.

    Raises:
        TracksError: the data are missing.
    """
    return cut_scene(read_recording().make_scene(VEHICLES.dt))


def cut_scene(scene: Scene) -> Scene:
    """Leave out the first steps, in which no vehicle has been seen for long enough."""
    return slice_scene(scene, slice(math.ceil(OBSERVED_WINDOW_S / VEHICLES.dt), None))


def read_recording() -> RealRecording:
    """Read the recording of five seconds, and an orthophoto.

    Raises:
        TracksError: the data are missing.
    """
    folder = require_data(DATA)
    tracks = read_geotrax(folder / "U_video_cut.csv", crs="EPSG:5186")
    positions = tracks.states[tracks.present][:, :2]
    corners = np.stack([positions.min(axis=0) - MARGIN_M, positions.max(axis=0) + MARGIN_M])
    path = folder / "ortho_U_25cm_epsg5186.tif"
    return RealRecording(tracks, read_imagery(path, world=tracks.world, corners=corners))
