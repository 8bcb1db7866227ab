"""How models are trained and evaluated on synthetic places."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from benchmarks.prediction.places import make_place_scene, read_map, read_recordings
from geoaim.aim.aim import AIM
from geoaim.base.defaults import SAMPLES
from geoaim.base.errors import TracksError
from geoaim.base.progress import Progress, notebook_progress
from geoaim.prediction.baselines import Predictor
from geoaim.prediction.config import (
    DEFAULT_CONFIGS,
    MAX_HISTORY_STEPS,
    SEGMENT_STEPS,
    Config,
    configure_training,
)
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.dataset import VAL_FRACTION, Dataset, make_dataset, split_scene
from geoaim.prediction.evaluation import EvalConfig, evaluate
from geoaim.prediction.metrics import Metric
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules

VEHICLES_ON_AIM = DEFAULT_CONFIGS["vehicle"]
VEHICLES = replace(VEHICLES_ON_AIM, surface_contrast=False)
PEDESTRIANS = DEFAULT_CONFIGS["pedestrian"]
TRAININGS = {
    "vehicle": configure_training("vehicle", steps=1600, batch_size=48),
    "pedestrian": configure_training("pedestrian", steps=900, batch_size=48),
}


def make_places_dataset(
    places: Sequence[Path],
    config: Config,
    map_name: str,
    *,
    val: Sequence[Path] = (),
    lights: bool = True,
    progress: Progress = notebook_progress,
) -> Dataset:
    """Make a dataset of all recordings of synthetic places, on one of their maps.

    Args:
        places: folders of the places.
        config: configuration of the model; recordings are resampled to its `dt`.
        map_name: a key of `experiments.places.MAPS`.
        val: folders of other places, to validate with; without them the last 5 % of each recording
            are for validation.
        lights: whether the scenes have traffic lights.
        progress: takes stage, done and total.

    Returns:
        Training and validation segments.
    """
    scenes: dict[Path, list[Scene]] = {}
    for number, folder in enumerate((*places, *val)):
        progress("places", number, len(places) + len(val))
        aim = read_map(folder, map_name)
        here = [
            make_place_scene(recording, aim, dt=config.dt, lights=lights)
            for recording in read_recordings(folder)
        ]
        scenes[folder] = [replace(scene, ground=here[0].ground) for scene in here]
    return make_dataset(
        [scene for folder in places for scene in scenes[folder]],
        config,
        val_fraction=VAL_FRACTION,
        val_scenes=[scene for folder in val for scene in scenes[folder]],
        progress=progress,
    )


@cache  # the places of several rows of a table are the same
def evaluate_place(
    predictor: Predictor,
    place: Path,
    config: Config,
    map_name: str,
    *,
    fraction: float = 1.0,
    lights: bool = True,
) -> list[dict[str, Metric]]:
    """Evaluate a predictor on every recording of a place.

    Args:
        predictor: a model's `sample`, or one of `BASELINES`.
        place: folder of the place.
        config: agent group, dt and resolution.
        map_name: a key of `experiments.places.MAPS`.
        fraction: share of each recording, at its end, to evaluate on.
        lights: whether the predictor gets the lights' states.

    Returns:
        Metrics of each recording in which agents of the group are present for long enough.
    """
    aim = read_map(place, map_name)
    return evaluate_on_map(predictor, place, config, aim, fraction=fraction, lights=lights)


def evaluate_on_map(
    predictor: Predictor,
    place: Path,
    config: Config,
    aim: AIM,
    *,
    fraction: float = 1.0,
    lights: bool = True,
) -> list[dict[str, Metric]]:
    """Evaluate a predictor on every recording of a place, on any map of it.

    Args:
        predictor: a model's `sample`, or one of `BASELINES`.
        place: folder of the place.
        config: agent group, dt and resolution.
        aim: the map.
        fraction: share of each recording, at its end, to evaluate on.
        lights: whether the predictor gets the lights' states.

    Returns:
        Metrics of each recording in which agents of the group are present for long enough.
    """
    parts = []
    for recording in read_recordings(place):
        _, scene = split_scene(make_place_scene(recording, aim, dt=config.dt), fraction)
        rules = recording.rules if config.kind == "vehicle" else NO_ROAD_RULES
        stride = 2 * SEGMENT_STEPS[config.kind]  # half of the recording is enough
        parts += evaluate_scene(predictor, scene, config, stride=stride, lights=lights, rules=rules)
    return parts


def evaluate_scene(  # noqa: PLR0913  (the scene, and how it is cut)
    predictor: Predictor,
    scene: Scene,
    config: Config,
    *,
    stride: int,
    steps: int | None = None,
    lights: bool = True,
    rules: RoadRules = NO_ROAD_RULES,
) -> list[dict[str, Metric]]:
    """Evaluate a predictor on joint segments of a scene.

    Args:
        predictor: a model's `sample`, or one of `BASELINES`.
        scene: the ground truth.
        config: agent group and resolution.
        stride: steps from one segment's start to the next.
        steps: of each segment; None: as in training.
        lights: whether the predictor gets the lights' states.
        rules: road rules (where vehicles may drive).

    Returns:
        Metrics; an empty list where no agent of the group is present for long enough.
    """
    steps = steps or SEGMENT_STEPS[config.kind]
    try:
        segments = cut_segments(scene, config.kind, steps=steps, stride=stride, joint=True)
    except TracksError:
        return []
    options = EvalConfig(MAX_HISTORY_STEPS, SAMPLES, show_lights=lights)
    ground = prefilter_ground(scene.ground, config.resolution)
    return [evaluate(predictor, segments, ground, options, rules=rules)]
