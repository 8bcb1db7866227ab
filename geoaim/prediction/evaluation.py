"""Evaluation of predictors on segments of one place."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch

from geoaim.base.errors import TracksError
from geoaim.base.progress import Progress, notebook_progress
from geoaim.prediction.baselines import Predictor
from geoaim.prediction.config import Config
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.dataset import split_scene
from geoaim.prediction.metrics import Metric, check_futures, compute_metrics, concat, keep_rates
from geoaim.prediction.neighbours import MAX_VIEWS
from geoaim.prediction.realism import compute_realism
from geoaim.prediction.segments import Segments, control_present, pick
from geoaim.rendering.ground import Ground, move_ground
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules
from geoaim.tracks.lights import UNKNOWN

RECORDING = "recording"  # name of `replay`, of which only rates are told


@dataclass(frozen=True)
class EvalConfig:
    """Options of an evaluation."""

    history: int  # observed steps
    samples: int  # futures of each segment
    seed: int = 0  # seed of the noise
    # whether predictors get the lights' states; infractions are counted anyway
    show_lights: bool = True
    realism: bool = False  # whether WOSAC's likelihoods are computed too


def evaluate(
    predictor: Predictor,
    segments: Segments,
    ground: Ground,
    config: EvalConfig,
    *,
    rules: RoadRules = NO_ROAD_RULES,
    progress: Progress = notebook_progress,
) -> dict[str, Metric]:
    """Compute all metrics of a predictor on segments of one place.

    Args:
        predictor: a model's `sample`, or one of `BASELINES`.
        segments: the ground truth.
        ground: the map. Give the result of `prefilter_ground`, or predictors that render views
            compute it for each batch.
        config: options.
        rules: road rules (where vehicles may drive), for infractions.
        progress: called with "evaluate", the number of segments done, and their total.

    Returns:
        Metrics by name; see `compute_metrics` and, with `config.realism`, `compute_realism`.

    Raises:
        ValueError: the predictor returns another shape, another number of samples, or states of
            controlled agents that are not finite.
        MapError: ground, segments or rules lie in worlds between which moving is not exact.
    """
    if len(segments.worlds) == 1 and ground.world is not None:
        ground = move_ground(ground, segments.worlds[0])
    generator = torch.Generator(segments.states.device).manual_seed(config.seed)
    max_agents = int(segments.controlled.sum(dim=1).max())
    size = max(1, MAX_VIEWS // (max_agents * config.samples))
    parts = []
    for start in range(0, len(segments), size):
        batch = pick(segments, slice(start, start + size))
        shown = batch
        if not config.show_lights:
            unknown = torch.full_like(batch.light_states, UNKNOWN)
            shown = replace(batch, light_states=unknown)
        futures = predictor(
            shown, ground, history=config.history, samples=config.samples, generator=generator
        )
        check_futures(futures, batch, config.history, config.samples)
        metrics = compute_metrics(futures, batch, config.history, rules)
        if config.realism:
            metrics |= compute_realism(futures, batch, config.history, rules)
        parts.append(metrics)
        progress("evaluate", min(start + size, len(segments)), len(segments))
    return concat(parts)


def judge(  # noqa: PLR0913  (what is judged, on what, and how)
    predictors: Mapping[str, Predictor],
    scenes: Sequence[Scene],
    model: Config,
    config: EvalConfig,
    *,
    fraction: float,
    horizon: int,
    rules: RoadRules = NO_ROAD_RULES,
    progress: Progress = notebook_progress,
) -> dict[str, dict[str, Metric]]:
    """Evaluate predictors jointly for all agents of a kind at the end of scenes.

    Args:
        predictors: predictors by name.
        scenes: scenes; those in which no agent is there for long enough add nothing.
        model: the configuration of the model: agent kind and resolution.
        config: options.
        fraction: share of each scene, at its end.
        horizon: predicted steps.
        rules: road rules, for infractions.
        progress: as of `evaluate`.

    Returns:
        Metrics of each predictor.

    Raises:
        TracksError: no agent is there for long enough in any scene.
    """
    found: dict[str, list[dict[str, Metric]]] = {name: [] for name in predictors}
    steps, problem = config.history + horizon, None
    for scene in scenes:
        _, end = split_scene(scene, fraction)
        try:
            segments = cut_segments(end, model.kind, steps=steps, stride=steps, joint=True)
        except TracksError as error:
            problem = error
            continue
        if model.num_anchors:  # a proposal needs all observed steps of its agent
            segments = control_present(segments, slice(config.history))
        ground = prefilter_ground(scene.ground, model.resolution)
        for name, predictor in predictors.items():
            given = segments, ground, config
            metrics = evaluate(predictor, *given, rules=rules, progress=progress)
            found[name].append(keep_rates(metrics) if name == RECORDING else metrics)
    if problem is not None and not any(found.values()):
        raise problem
    return {name: concat(parts) for name, parts in found.items()}
