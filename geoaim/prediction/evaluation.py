"""A model and the training-free baselines on the same segments: what `geoaim evaluate` does."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.lights import UNKNOWN
from geoaim.prediction.baselines import BASELINES, predict_plainly
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import Measure, measure, merged
from geoaim.prediction.segments import Segments, pick
from geoaim.prediction.windows import OBSERVED, Windows
from geoaim.progress import Progress, no_progress
from geoaim.simulation.episodes import NO_RULES, Rules
from geoaim.simulation.ground import Ground

VIEWS = 4000  # of all samples and agents that are drawn at once, at most


@dataclass(frozen=True)
class Asked:
    """What is asked of every predictor.

    Attributes:
        observed: steps that are known.
        samples: futures.
        spread: of a model's latents.
        seed: of the noise.
        lights: whether their states are shown to the predictor; what is run over counts anyway.
    """

    observed: int
    samples: int
    spread: float = 1.0
    seed: int = 0
    lights: bool = True


def evaluate(
    model: ITRA | str,
    segments: Segments,
    ground: Ground,
    asked: Asked,
    *,
    rules: Rules = NO_RULES,
    report: Progress = no_progress,
) -> dict[str, Measure]:
    """All measures of a model, or of one of `BASELINES`, on segments of one place."""
    generator = torch.Generator(segments.states.device).manual_seed(asked.seed)
    name = model if isinstance(model, str) else "model"
    parts, size = [], _at_once(segments, asked)
    for start in range(0, len(segments), size):
        some = pick(segments, slice(start, start + size))
        found = _predicted(model, some, ground, asked, generator)
        parts.append(measure(found, some, asked.observed, rules))
        report(name, min(start + size, len(segments)), len(segments))
    return merged(parts)


def evaluate_windows(
    model: ITRA | str,
    windows: Windows,
    samples: int,
    *,
    seed: int = 0,
    report: Progress = no_progress,
) -> dict[str, Measure]:
    """minADE and minFDE of windows, in the pixels of their images and in metres.

    Latents of a model whose plans are enough for all samples stay at their mean: plans spread.
    """
    planned = isinstance(model, ITRA) and model.config.modes >= samples
    asked = Asked(OBSERVED, samples, spread=0.0 if planned else 1.0, seed=seed)
    found = evaluate(model, windows.segments, windows.ground, asked, report=report)
    scale = windows.metres.double().numpy()
    measures = {}
    for name in ("minADE", "minFDE"):
        measures[f"{name}_px"] = Measure(found[name].sums / scale, found[name].counts)
        measures[f"{name}_m"] = found[name]
    return measures


def compare(
    model: ITRA,
    judge: Callable[[ITRA | str], dict[str, Measure]],
) -> Mapping[str, dict[str, Measure]]:
    """The model's measures and those of all baselines."""
    return {"model": judge(model)} | {name: judge(name) for name in BASELINES}


def _predicted(
    model: ITRA | str, segments: Segments, ground: Ground, asked: Asked, generator: torch.Generator
) -> Float[Tensor, "S K T A 4"]:
    observed, samples = asked.observed, asked.samples
    if not asked.lights:
        segments = replace(segments, lights=torch.full_like(segments.lights, UNKNOWN))
    if isinstance(model, str):
        return predict_plainly(
            model, segments, observed=observed, samples=samples, generator=generator
        )
    return model.sample(
        segments,
        ground,
        observed=observed,
        samples=samples,
        generator=generator,
        spread=asked.spread,
    )


def _at_once(segments: Segments, asked: Asked) -> int:
    most = int(segments.controlled.sum(dim=1).max())
    return max(1, VIEWS // (most * asked.samples))
