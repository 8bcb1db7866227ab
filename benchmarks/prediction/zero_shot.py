"""The models that come with the package on real places, of which they saw none."""

from collections.abc import Mapping, Sequence
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
from geoaim.prediction.config import SEGMENT_STEPS
from geoaim.prediction.metrics import MIN_SEGMENTS, concat, keep_rates
from geoaim.rendering.scene import Scene
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules

NOISY = "constant velocity with noise"
Case = tuple[Scene, RoadRules]


def run(workspace: Workspace) -> list[Path]:
    """Evaluate the pretrained models on real places, zero-shot; return the files."""
    metrics: dict[str, Metrics] = {}
    differences = {}
    sets = _list_sets()
    for number, (name, cases) in enumerate(sets.items()):
        workspace.progress("evaluate", number, len(sets))
        found = _evaluate(name.split()[-1].removesuffix("s"), cases)
        metrics |= {f"{name}, {method}": values for method, values in found.items()}
        if len(found[NOISY]["minADE"].sums) >= MIN_SEGMENTS:
            differences[name] = compute_differences(found["ITRA"], found[NOISY])
    settings = {"ITRA minus constant velocity with noise": differences}
    return write_results("zero_shot", metrics, settings, workspace.results)


def _list_sets() -> Mapping[str, Sequence[Case]]:
    """List the recordings of each set; the last word of its name is the kind of its agents."""
    vehicle, pedestrian = (read_pretrained(kind).config.dt for kind in ("vehicle", "pedestrian"))

    def make_cases(recordings: Sequence[RealRecording], dt: float) -> list[Case]:
        return [(recording.make_scene(dt), recording.rules) for recording in recordings]

    return {
        "Songdo, 1 place, vehicles": [(songdo.read_scene(), NO_ROAD_RULES)],
        **{
            f"Karlsruhe {junction[:4]}, 1 place, vehicles": make_cases(
                list(read_karlsruhe(junction)), vehicle
            )
            for junction in KARLSRUHE
        },
        "Stanford, 2 places, pedestrians": make_cases(
            [one for place in STANFORD_TEST for one in read_stanford(place)], pedestrian
        ),
        "SinD, 2 places, pedestrians": [(scene, NO_ROAD_RULES) for scene in sind.read_scenes()],
    }


def _evaluate(kind: str, cases: Sequence[Case]) -> dict[str, Metrics]:
    """Evaluate the model of a kind of agents and all baselines jointly on recordings."""
    model, stride = read_pretrained(kind), SEGMENT_STEPS[kind]
    predictors: dict[str, Predictor] = {"ITRA": model.sample, **BASELINES, "recording": replay}
    found = {
        name: concat(
            [
                part
                for scene, rules in cases
                for part in evaluate_scene(
                    predictor, scene, model.config, stride=stride, rules=rules
                )
            ]
        )
        for name, predictor in predictors.items()
    }
    return {**found, "recording": keep_rates(found["recording"])}
