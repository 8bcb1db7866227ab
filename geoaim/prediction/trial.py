"""A model's trial on what was recorded before a prediction starts, at a place it never saw."""

from geoaim.base.defaults import SAMPLES
from geoaim.base.errors import TracksError
from geoaim.base.progress import no_progress
from geoaim.prediction.baselines import BASELINES, NOISY
from geoaim.prediction.config import MAX_HISTORY_STEPS
from geoaim.prediction.evaluation import EvalConfig, judge
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import Metric
from geoaim.rendering.scene import Scene, slice_scene

TESTED_SEGMENTS = 5  # most of them: 0.4 to 1.2 times the work of the prediction
# of the error of constant velocity with noise: with less between them either was as often the
# better one afterwards (`python -m benchmarks.prediction zero_shot_before`, places of validation)
SAME_SHARE = 0.1
# probability of constant velocity with noise where the model is no better. 0.3, 0.5, 0.8 gave
# minADE of 7.05, 6.89, 6.84 m after 3 s and 8.95, 8.21, 8.28 m after 8 s at Karlsruhe k733, with
# the model alone 7.39 and 9.55; where it is better, mixing costs (0.26 to 0.37 m at a made place)
NOISE_SHARE = 0.5


def judge_before(model: ITRA, scene: Scene, start: int, horizon: int) -> dict[str, Metric]:
    """Judge a model and constant velocity with noise on what was recorded until a step.

    Plain draws are judged, in an eighth of the time that the prediction takes for as many agents;
    their errors are some 5 % larger.

    Args:
        model: the model, which never saw the recording.
        scene: the recording.
        start: the last observed step of the prediction.
        horizon: predicted steps, as many as are judged.

    Returns:
        minADE of "model" and `NOISY`; none where nobody was there for long enough.
    """
    steps = MAX_HISTORY_STEPS + horizon
    count = min(TESTED_SEGMENTS, (start + 1) // steps)
    before = slice_scene(scene, slice(start + 1 - count * steps, start + 1))
    predictors = {"model": model.sample, NOISY: BASELINES[NOISY]}
    given = predictors, [before], model.config, EvalConfig(MAX_HISTORY_STEPS, SAMPLES)
    try:
        metrics = judge(*given, fraction=1.0, horizon=horizon, progress=no_progress)
    except TracksError:
        return {}
    errors = {name: values["minADE"] for name, values in metrics.items()}
    return errors if errors["model"].counts.any() else {}


def compare_with_noise(errors: dict[str, Metric]) -> str:
    """Say whether a model is "better", "as good" or "worse" than constant velocity with noise."""
    model, noisy = errors["model"].mean, errors[NOISY].mean
    if abs(model - noisy) <= SAME_SHARE * noisy:
        return "as good"
    return "better" if model < noisy else "worse"


def choose_noise(errors: dict[str, Metric]) -> float:
    """Choose the `noise` that `predict` adds, by what `judge_before` found."""
    return NOISE_SHARE if errors and compare_with_noise(errors) != "better" else 0.0


def describe_trial(errors: dict[str, Metric]) -> str:
    """Describe what a model's test before the start of a prediction has shown."""
    if not errors:
        return (
            "Too little was recorded before the start to test the model: at some places constant "
            "velocity with noise is as good or better; geoaim train learns a place"
        )
    found, count = compare_with_noise(errors), errors["model"].counts.sum()
    advice = "" if found == "better" else ", so both are mixed: learn the place by geoaim train"
    text = ", ".join(f"{name} {error.mean:.2f} m" for name, error in errors.items())
    verdict = {"better": "better than", "as good": "no better than", "worse": "worse than"}[found]
    return (
        f"Before the start, minADE of {SAMPLES} futures of {count:g} agents: {text}: the model is "
        f"{verdict} that here{advice}"
    )
