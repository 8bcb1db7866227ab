"""The models that come with the package on real places, of which they saw none."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.prediction import sind, songdo
from benchmarks.prediction.protocol import evaluate_scene
from benchmarks.prediction.real_places import (
    KARLSRUHE,
    STANFORD_TEST,
    RealRecording,
    read_karlsruhe,
    read_stanford,
)
from benchmarks.prediction.results import Metrics, Workspace, compute_differences, write_results
from geoaim.prediction.baselines import BASELINES, Predictor, replay
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS, SEGMENT_STEPS
from geoaim.prediction.controllers import follow
from geoaim.prediction.metrics import MIN_SEGMENTS, concat, keep_rates
from geoaim.rendering.scene import Scene
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules

NOISY = "constant velocity with noise"
LATER_S = (5, 8)  # horizons beside the models' own, of recordings that are long enough


@dataclass(frozen=True, eq=False)
class RecordingSet:
    """Recordings of one kind of agents, and the steps of their segments."""

    kind: str
    cases: Sequence[tuple[Scene, RoadRules]]
    steps: int


def run(workspace: Workspace) -> list[Path]:
    """Evaluate the pretrained models on real places, zero-shot; return the files."""
    metrics: dict[str, Metrics] = {}
    differences = {}
    sets = _list_sets()
    for number, (name, one) in enumerate(sets.items()):
        workspace.progress("evaluate", number, len(sets))
        found = _evaluate(one)
        metrics |= {f"{name}, {method}": values for method, values in found.items()}
        if len(found[NOISY]["minADE"].sums) >= MIN_SEGMENTS:
            differences[name] = compute_differences(found["ITRA"], found[NOISY])
    settings = {"ITRA minus constant velocity with noise": differences}
    return write_results("zero_shot", metrics, settings, workspace.results)


def _list_sets() -> Mapping[str, RecordingSet]:
    """List the recordings of each set."""
    dt = {kind: read_pretrained(kind).config.dt for kind in ("vehicle", "pedestrian")}

    def make_set(kind: str, recordings: Sequence[RealRecording]) -> RecordingSet:
        cases = [(recording.make_scene(dt[kind]), recording.rules) for recording in recordings]
        return RecordingSet(kind, cases, SEGMENT_STEPS[kind])

    songdo_cases = [(songdo.read_scene(), NO_ROAD_RULES)]
    sets = {
        "Songdo, 1 place, vehicles": RecordingSet("vehicle", songdo_cases, SEGMENT_STEPS["vehicle"])
    }
    for junction in KARLSRUHE:
        name = f"Karlsruhe {junction[:4]}, 1 place, vehicles"
        sets[name] = make_set("vehicle", list(read_karlsruhe(junction)))
        for seconds in LATER_S:
            steps = MAX_HISTORY_STEPS + round(seconds / dt["vehicle"])
            sets[f"{name}, {seconds} s"] = replace(sets[name], steps=steps)
    stanford = [one for place in STANFORD_TEST for one in read_stanford(place)]
    sets["Stanford, 2 places, pedestrians"] = make_set("pedestrian", stanford)
    cases = [(scene, NO_ROAD_RULES) for scene in sind.read_scenes()]
    sets["SinD, 2 places, pedestrians"] = RecordingSet(
        "pedestrian", cases, SEGMENT_STEPS["pedestrian"]
    )
    return sets


def _evaluate(one: RecordingSet) -> dict[str, Metrics]:
    """Evaluate the model and all baselines jointly on recordings."""
    model = read_pretrained(one.kind)
    predictors: dict[str, Predictor] = {"ITRA": model.sample, **BASELINES, "recording": replay}
    if model.config.brakes:
        alone = read_pretrained(one.kind)
        alone.controllers = [follow]
        predictors["ITRA, networks alone"] = alone.sample
    found = {
        name: concat(
            [
                part
                for scene, rules in one.cases
                for part in evaluate_scene(
                    predictor,
                    scene,
                    model.config,
                    stride=SEGMENT_STEPS[one.kind],
                    steps=one.steps,
                    rules=rules,
                )
            ]
        )
        for name, predictor in predictors.items()
    }
    return {**found, "recording": keep_rates(found["recording"])}
