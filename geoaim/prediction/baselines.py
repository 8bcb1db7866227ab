"""Baselines: predictors that need no training. Their signature is that of `ITRA.sample`."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.prediction.segments import Segments, make_segment_scenario, repeat
from geoaim.simulation.ground import Ground
from geoaim.simulation.policies import constant_turn_rate, constant_velocity
from geoaim.simulation.simulator import Policy, rollout

HEADING_NOISE_RAD, SPEED_NOISE = 0.3, 0.3  # standard deviations; of speed, as a share of it


@runtime_checkable
class Predictor(Protocol):
    """Predicts futures of all controlled agents; a trained model's predictor is `model.sample`.

    Shapes: B segments, K samples, N agents, T steps.
    """

    def __call__(
        self,
        segments: Segments,
        ground: Ground,
        *,
        history: int,
        samples: int,
        generator: torch.Generator,
    ) -> Float[Tensor, "B K N T 4"]:
        """Predict K joint futures of each segment.

        Args:
            segments: segments, whose first steps are observed.
            ground: the map, prefiltered or not (see `ITRA.sample`); baselines do not use it.
            history: observed steps.
            samples: K futures to draw.
            generator: source of the noise, on the segments' device.

        Returns:
            x, y (m), heading (rad), speed (m/s) of all agents at all steps, the observed ones
            included.
        """
        ...


def _predict_with_policy(
    policy: Policy,
    segments: Segments,
    ground: Ground,
    *,
    history: int,
    samples: int,
    generator: torch.Generator,
) -> Float[Tensor, "B K N T 4"]:
    """Roll agents out by a policy of the simulator; all samples are the same."""
    scenario = make_segment_scenario(segments)
    states = rollout(scenario, policy, segments.controlled, history=history)
    return states[:, None].expand(-1, samples, -1, -1, -1)


def _predict_with_noise(
    segments: Segments, ground: Ground, *, history: int, samples: int, generator: torch.Generator
) -> Float[Tensor, "B K N T 4"]:
    """Continue at constant velocity after noise on heading and speed at the last observed step.

    Schöller et al. 2020.
    """
    repeated = repeat(segments, samples)
    states = repeated.states
    shape = len(repeated), states.shape[1], 2
    noise = torch.randn(shape, generator=generator, device=states.device)
    noise = torch.where(repeated.controlled[..., None], noise, 0.0)
    x, y, heading, speed = states[:, :, history - 1].unbind(-1)
    heading = heading + HEADING_NOISE_RAD * noise[..., 0]
    speed = speed * (1 + SPEED_NOISE * noise[..., 1])
    last = torch.stack([x, y, heading, speed], dim=-1)
    parts = states[:, :, : history - 1], last[:, :, None], states[:, :, history:]
    states = torch.cat(parts, dim=2)
    noisy = replace(repeated, states=states)
    futures = _predict_with_policy(
        constant_velocity, noisy, ground, history=history, samples=1, generator=generator
    )
    return futures.view(len(segments), samples, *futures.shape[2:])


def replay(
    segments: Segments, ground: Ground, *, history: int, samples: int, generator: torch.Generator
) -> Float[Tensor, "B K N T 4"]:
    """Repeat what was recorded: a `Predictor` that knows the future, for the recording's rates.

    Args:
        segments: as of `Predictor`.
        ground: not used.
        history: not used.
        samples: K equal futures.
        generator: not used.

    Returns:
        The recorded states.
    """
    return segments.states[:, None].expand(-1, samples, -1, -1, -1)


BASELINES: Mapping[str, Predictor] = {
    "constant velocity": partial(_predict_with_policy, constant_velocity),
    "constant velocity with noise": _predict_with_noise,
    "constant turn rate": partial(_predict_with_policy, constant_turn_rate),
}
