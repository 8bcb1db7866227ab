"""How headings and speeds are best known from past positions: on validation data.

Every second vehicle of Songdo, those that `songdo` fine-tunes on, and the pedestrians of one
Stanford place. Differences of positions over a window, and slopes at its end of a line and of a
parabola that fit the positions in it.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.prediction import songdo
from benchmarks.prediction.averages import merge_segments
from benchmarks.prediction.protocol import PEDESTRIANS, VEHICLES, evaluate_scene
from benchmarks.prediction.real_places import STANFORD_VAL, RealRecording, read_stanford
from benchmarks.prediction.results import Metrics, Workspace, write_results
from geoaim.base.defaults import SAMPLES
from geoaim.prediction.baselines import BASELINES, Predictor
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS, SEGMENT_STEPS
from geoaim.prediction.evaluation import EvalConfig, evaluate
from geoaim.prediction.metrics import Metric, concat
from geoaim.rendering.scene import Scene
from geoaim.tracks.formats.motion import estimate_velocity
from geoaim.tracks.tracks import Tracks, estimate_heading

WINDOWS_S = {0: (0.1, 0.25, 0.35, 0.5, 0.75, 1.0), 1: (0.5, 0.75, 1.0), 2: (1.0, 1.5)}
NAMES = ("differences", "line", "parabola")  # by degree; 0 is no fit
Estimate = Callable[[Tracks], Float[Array, "N T 2"]]  # velocities, m/s


def run(workspace: Workspace) -> list[Path]:
    """Compare ways to know headings and speeds from past positions; return the files."""
    ways: dict[str, Estimate] = {"central differences, which know 0.5 s of the future": _centre}
    for degree, windows in WINDOWS_S.items():
        for window in windows:
            ways[f"{NAMES[degree]} of {window:g} s"] = partial(_estimate, degree, window)
    metrics: dict[str, Metrics] = {}
    for number, (name, estimate) in enumerate(ways.items()):
        workspace.progress("evaluate", number, len(ways))
        found = {"Songdo": _evaluate_songdo(estimate), "Stanford": _evaluate_stanford(estimate)}
        metrics[name] = {
            f"{place}, {method}": metric
            for place, values in found.items()
            for method, metric in values.items()
        }
    settings = {"metric": "minADE, m, of 6 samples", "evaluated on": "validation data"}
    return write_results("observed_states", metrics, settings, workspace.results)


def _centre(tracks: Tracks) -> Float[Array, "N T 2"]:
    return estimate_velocity(tracks, 0.5, 0.5)


def _estimate(degree: int, window: float, tracks: Tracks) -> Float[Array, "N T 2"]:
    """Estimate velocities by the positions of the last `window` seconds."""
    if degree == 0:
        return estimate_velocity(tracks, window, 0.0)
    velocity = np.full((*tracks.present.shape, 2), np.nan)
    for agent, present in enumerate(tracks.present):
        steps = np.flatnonzero(present)
        for last, step in enumerate(steps[1:], 1):
            ago = tracks.times[steps[: last + 1]] - tracks.times[step]
            first = min(int(np.searchsorted(ago, -window)), last - 1)
            powers = np.vander(ago[first:], min(degree, last - first) + 1, increasing=True)
            positions = tracks.states[agent, steps[first : last + 1], :2]
            velocity[agent, step] = np.linalg.lstsq(powers, positions, rcond=None)[0][1]
    return velocity


def _evaluate_songdo(estimate: Estimate) -> dict[str, Metric]:
    """Compute minADE of those vehicles of Songdo that are not in its table, by predictor."""
    scene = songdo.cut_scene(_make_scene(songdo.read_recording(), estimate, VEHICLES.dt))
    dataset = songdo.make_dataset(scene)
    options = EvalConfig(MAX_HISTORY_STEPS, SAMPLES)
    return {
        name: merge_segments(evaluate(predictor, dataset.train, dataset.ground, options))["minADE"]
        for name, predictor in _list_predictors("vehicle").items()
    }


def _evaluate_stanford(estimate: Estimate) -> dict[str, Metric]:
    """Compute minADE of pedestrians of a Stanford place that is in no table, by predictor."""
    scenes = [_make_scene(one, estimate, PEDESTRIANS.dt) for one in read_stanford(STANFORD_VAL)]
    stride, found = SEGMENT_STEPS["pedestrian"], {}
    for name, predictor in _list_predictors("pedestrian").items():
        parts = [evaluate_scene(predictor, one, PEDESTRIANS, stride=stride) for one in scenes]
        found[name] = concat([metrics for part in parts for metrics in part])["minADE"]
    return found


def _list_predictors(kind: str) -> Mapping[str, Predictor]:
    return {"ITRA": read_pretrained(kind).sample, **BASELINES}


def _make_scene(recording: RealRecording, estimate: Estimate, dt: float) -> Scene:
    """Make a scene whose observed headings and speeds are estimated."""
    tracks = recording.tracks
    velocity = np.nan_to_num(estimate(tracks))
    heading = estimate_heading(velocity, causal=True)
    observed = tracks.states.copy()
    observed[..., 2:] = np.stack([heading, np.hypot(*velocity.T).T], axis=-1)
    observed[~tracks.present] = np.nan
    return replace(recording, tracks=replace(tracks, observed=observed)).make_scene(dt)
