"""The models that come with the package on real places, of which they saw none."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from benchmarks.prediction import sind, songdo
from benchmarks.prediction.places import make_drawn_scene
from benchmarks.prediction.protocol import evaluate_scene
from benchmarks.prediction.reaction import write_rows
from benchmarks.prediction.real_places import (
    KARLSRUHE,
    STANFORD_TEST,
    RealRecording,
    read_karlsruhe,
    read_stanford,
    read_zhengzhou,
)
from benchmarks.prediction.results import Metrics, Workspace, compute_differences, write_results
from geoaim.base.defaults import SAMPLES
from geoaim.base.errors import TracksError
from geoaim.base.progress import no_progress
from geoaim.prediction.baselines import BASELINES, NOISY, Predictor, replay
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS, SEGMENT_STEPS
from geoaim.prediction.controllers import follow
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.evaluation import EvalConfig, evaluate
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import MIN_SEGMENTS, Metric, concat, keep_rates
from geoaim.prediction.predict import draw_covering
from geoaim.prediction.segments import Segments
from geoaim.prediction.trial import choose_noise, compare_with_noise, judge_before
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene, slice_scene
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules

LATER_S = (5, 8)  # horizons beside the models' own, of recordings that are long enough
TESTED_S = (3, 8)  # horizons at which the test before a prediction is judged
MAX_STARTS = 16  # of predictions at one place, at even intervals
MINUTES = 3.0  # of made traffic
GIVEN = "as predict gives"
NAMES = ("model", NOISY, GIVEN)
Starts = list[tuple[dict[str, Metric], dict[str, dict[str, Metric]]]]


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
    settings = {f"ITRA minus {NOISY}": differences}
    return write_results("zero_shot", metrics, settings, workspace.results)


def run_tests_before(workspace: Workspace) -> list[Path]:
    """Judge what `predict` says beforehand, better than noise or not, by what happens afterwards.

    `TESTED_SEGMENTS` and `SAME_SHARE` were chosen on the places of validation.
    """
    rows = []
    places = _list_tested_places()
    for number, (name, read) in enumerate(places.items()):
        workspace.progress("places", number, len(places))
        scenes = read()
        longest = max(len(scene.times) for scene in scenes) * scenes[0].dt
        rows += [
            {"place": name, "s": s, **_judge_tests(scenes, s)} for s in TESTED_S if s + 1 < longest
        ]
    return write_rows("zero_shot_before", {"places": rows}, workspace)


def _list_tested_places() -> Mapping[str, Callable[[], list[Scene]]]:
    """List places on which the test before a prediction is judged."""

    def read(junction: str) -> list[Scene]:
        return [one.make_scene(0.1) for one in read_karlsruhe(junction)]

    return {
        "validation, k733": lambda: read(KARLSRUHE[1]),
        "validation, Zhengzhou 0592": lambda: [read_zhengzhou("DJI_0592").make_scene(0.1)],
        "test, k729": lambda: read(KARLSRUHE[0]),
        "test, Zhengzhou 0590": lambda: [read_zhengzhou("DJI_0590_0").make_scene(0.1)],
        "test, Songdo": lambda: [songdo.read_scene()],
        "test, made junction 932": lambda: [make_drawn_scene("junction", 932, minutes=MINUTES)[0]],
    }


def _judge_tests(scenes: Sequence[Scene], seconds: float) -> dict[str, float | str]:
    """Count what the test says at starts of predictions, and where that is so afterwards."""
    model = read_pretrained("vehicle")
    horizon = round(seconds / model.config.dt)
    step = MAX_HISTORY_STEPS + horizon
    starts = [
        (scene, start, segment)
        for scene in scenes
        for start in range(MAX_HISTORY_STEPS - 1, len(scene.times) - horizon, step)
        if (segment := _cut_after(scene, start, horizon)) is not None
    ]
    found: Starts = []
    for scene, start, segment in starts[:: max(1, -(-len(starts) // MAX_STARTS))]:
        before = judge_before(model, scene, start, horizon)
        found.append((before, _judge_after(model, scene, segment, choose_noise(before))))
    told = [before for before in found if before[0]]
    row: dict[str, float | str] = {f"after, {name}": _describe(found, name) for name in NAMES}
    row |= {"starts": len(found), "untested": len(found) - len(told)}
    for answer in ("better", "as good", "worse"):
        some = [one for one in told if compare_with_noise(one[0]) == answer]
        right = sum(one["model"]["minADE"].mean < one[NOISY]["minADE"].mean for _, one in some)
        means = ", ".join(f"{_average(some, name, 'minADE'):.2f}" for name in NAMES if some)
        row[f"told {answer}, then better"] = f"{len(some)}, {right}" + (f" ({means})" * bool(some))
    return row


def _cut_after(scene: Scene, start: int, horizon: int) -> Segments | None:
    """Cut the segment of a prediction; None where nobody is there to its end."""
    piece = slice_scene(scene, slice(start + 1 - MAX_HISTORY_STEPS, start + 1 + horizon))
    steps = len(piece.times)
    try:
        return cut_segments(piece, "vehicle", steps=steps, stride=steps, joint=True)
    except TracksError:
        return None


def _judge_after(
    model: ITRA, scene: Scene, segment: Segments, noise: float
) -> dict[str, dict[str, Metric]]:
    """Metrics after a start: of the model alone, of noise, and of what `predict` gives."""
    ground = prefilter_ground(scene.ground, model.config.resolution)
    predictors: dict[str, Predictor] = {
        "model": partial(draw_covering, model),
        NOISY: BASELINES[NOISY],
    }
    if noise:
        predictors[GIVEN] = partial(draw_covering, model, noise=noise)
    given = segment, ground, EvalConfig(MAX_HISTORY_STEPS, SAMPLES)
    found = {
        name: evaluate(predictor, *given, progress=no_progress)
        for name, predictor in predictors.items()
    }
    return {GIVEN: found["model"]} | found


def _average(found: Starts, name: str, metric: str) -> float:
    """The mean of a predictor's errors after some starts."""
    parts = [{metric: after[name][metric]} for _, after in found]
    return concat(parts)[metric].mean if parts else float("nan")


def _describe(found: Starts, name: str) -> str:
    return " / ".join(f"{_average(found, name, one):.2f}" for one in ("minADE", "joint minADE"))


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
