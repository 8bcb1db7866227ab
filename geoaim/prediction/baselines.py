"""Baselines: predictors that need no training. Their signature is that of `ITRA.sample`."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Protocol, runtime_checkable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from geoaim.prediction.segments import Segments, make_segment_scenario, mark_entries, repeat
from geoaim.rendering.ground import Ground
from geoaim.simulation.simulator import Policy, constant_turn_rate, constant_velocity, rollout

HEADING_NOISE_RAD, SPEED_NOISE = 0.3, 0.3  # standard deviations; of speed, as a share of it
NOISY = "constant velocity with noise"


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
    """Continue at constant velocity after noise on heading and speed.

    The noise is that of the last observed step, or of the step at which an agent enters (Schöller
    et al. 2020).
    """
    repeated = repeat(segments, samples)
    states = repeated.states
    shape = len(repeated), states.shape[1], 2
    noise = torch.randn(shape, generator=generator, device=states.device)
    noise = torch.where(repeated.controlled[..., None], noise, 0.0)[:, :, None]
    starts = mark_entries(repeated.present, history)
    starts = F.pad(F.pad(starts, (1, 0), value=True), (history - 1, 0))  # (B K, N, T)
    x, y, heading, speed = states.unbind(-1)
    turned = heading + HEADING_NOISE_RAD * noise[..., 0]
    faster = speed * (1 + SPEED_NOISE * noise[..., 1])
    changed = torch.stack([x, y, turned, faster], dim=-1)
    noisy = replace(repeated, states=torch.where(starts[..., None], changed, states))
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
    NOISY: _predict_with_noise,
    "constant turn rate": partial(_predict_with_policy, constant_turn_rate),
}
