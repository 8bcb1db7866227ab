"""Futures of a scene: what a model thinks that may happen next."""

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.prediction.itra import ITRA
from geoaim.prediction.segments import cut_ahead
from geoaim.simulation.ground import fit_ground
from geoaim.simulation.scene import Scene, step_seconds

OBSERVED = 10  # steps before the prediction that a model gets at most, as in training


def predict(
    model: ITRA,
    scene: Scene,
    *,
    samples: int = 6,
    steps: int = 40,
    start: int | None = None,
    generator: torch.Generator,
) -> Float[Tensor, "K N T 4"]:
    """Draw joint futures of all agents of the model's kind.

    Args:
        model: from `read_model` or `train`.
        scene: map, agents and lights, at the model's steps.
        samples: futures.
        steps: of each.
        start: step of the scene that is the last one known; its last if left out.
        generator: of the noise.

    Returns:
        x, y, heading and speed of everybody at the steps after `start`; NaN of who is not there.
        Others replay, and go straight on beyond the scene's end; lights stay as they were last.

    Raises:
        TracksError: nobody of the kind is there at that step.
        ValueError: the scene's steps are not the model's, there is no such step, or a model with
            plans needs more known ones.
    """
    config, total = model.config, len(scene.times)
    start = total - 1 if start is None else start
    if not 0 <= start < total:
        raise ValueError(f"step {start} is not among the scene's {total}")
    if total > 1 and abs(step_seconds(scene) - config.seconds) > 1e-3:
        raise ValueError(
            f"the scene's steps are {step_seconds(scene):g} s and the model's "
            f"{config.seconds:g} s; resample the tracks"
        )
    first = max(0, start + 1 - (config.known or OBSERVED))
    segment = cut_ahead(scene, config.kind, config.seconds, first=first, start=start, steps=steps)
    observed = start + 1 - first
    ground = fit_ground(scene.ground, config.resolution)
    found = model.sample(segment, ground, observed=observed, samples=samples, generator=generator)[
        0, :, observed:
    ]
    there = segment.present[0, observed:, :, None]
    return torch.where(there, found, torch.nan).transpose(1, 2)
