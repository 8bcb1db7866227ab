"""Evaluation of predictors on segments of one place, or on windows of a benchmark."""

from dataclasses import dataclass, replace
from functools import partial

import torch

from geoaim.base.progress import Progress, notebook_progress
from geoaim.prediction.baselines import Predictor
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import Metric, check_futures, compute_metrics, concat
from geoaim.prediction.neighbours import MAX_VIEWS
from geoaim.prediction.realism import compute_realism
from geoaim.prediction.segments import Segments, pick
from geoaim.prediction.windows import HISTORY_STEPS, Windows
from geoaim.rendering.ground import Ground, move_ground
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules
from geoaim.tracks.lights import UNKNOWN


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


def evaluate_windows(
    predictor: Predictor,
    windows: Windows,
    samples: int,
    *,
    seed: int = 0,
    progress: Progress = notebook_progress,
) -> dict[str, Metric]:
    """Compute minADE and minFDE of windows, in pixels of their images and in metres.

    Args:
        predictor: `make_window_predictor` of a model, or one of `BASELINES`.
        windows: the ground truth.
        samples: futures of each window.
        seed: seed of the noise.
        progress: takes stage, done and total.

    Returns:
        Metrics `minADE_px`, `minADE_m`, `minFDE_px` and `minFDE_m`.
    """
    config = EvalConfig(HISTORY_STEPS, samples, seed=seed)
    metres = evaluate(predictor, windows.segments, windows.ground, config, progress=progress)
    resolutions = windows.resolutions.double().numpy()
    metrics = {}
    for name in ("minADE", "minFDE"):
        metrics[f"{name}_px"] = Metric(metres[name].sums / resolutions, metres[name].counts)
        metrics[f"{name}_m"] = metres[name]
    return metrics


def make_window_predictor(model: ITRA, samples: int) -> Predictor:
    """Make the predictor of a model for `evaluate_windows` with `samples` futures.

    With at least as many proposals as samples, latents are set to their mean.
    """
    proposals = model.config.num_anchors >= samples
    return partial(model.sample, latent_scale=0.0 if proposals else 1.0)
