"""Segments: pieces of recordings as tensors of one shape, for training and evaluation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.tracks.lights import UNKNOWN

VEHICLE, PEDESTRIAN = 0, 1  # layers of an observation; cyclists are drawn with pedestrians


@dataclass(frozen=True, eq=False)
class Segments:
    """B pieces of T steps, each with up to N agents and L lights."""

    states: Float[Tensor, "B T N 4"]  # x, y, heading, speed; 0 while absent
    present: Bool[Tensor, "B T N"]  # whether the agent is there
    sizes: Float[Tensor, "B N 2"]  # length and width, metres; 1 in padding
    layers: Int[Tensor, "B N"]  # the layer that the agent is drawn in, `VEHICLE` or `PEDESTRIAN`
    controlled: Bool[Tensor, "B N"]  # whether the model controls the agent; others replay
    places: Int[Tensor, "B"]  # number of the segment's map in the ground of all maps
    stop_lines: Float[Tensor, "B L 2 2"]  # both ends of each light's line, metres
    light_states: Int[Tensor, "B T L"]  # states, as in `geoaim.tracks.lights`
    dt: float  # time between steps, s

    def __len__(self) -> int:
        return len(self.states)


TENSORS = [field.name for field in fields(Segments) if field.name != "dt"]


def pick(segments: Segments, index: Tensor | slice) -> Segments:
    """Select some of the segments, by their rows or a mask of them."""
    return _map_tensors(segments, lambda tensor: tensor[index])


def move_to(segments: Segments, device: torch.device | str) -> Segments:
    """Move segments to a device."""
    return _map_tensors(segments, lambda tensor: tensor.to(device))


def repeat(segments: Segments, samples: int) -> Segments:
    """Repeat each segment `samples` times, copies of one segment next to each other."""
    return _map_tensors(segments, lambda tensor: tensor.repeat_interleave(samples, dim=0))


def concat(parts: Sequence[Segments]) -> Segments:
    """Concatenate segments of equally many steps, padded to the most agents and lights.

    Raises:
        ValueError: there are none, or the time between their steps differs.
    """
    dts = sorted({part.dt for part in parts})
    if len(dts) != 1:
        stated = ", ".join(f"{dt:g}" for dt in dts) or "none"
        raise ValueError(f"dt of the segments, in s: {stated}; one or more of one dt are needed")
    agents = max(part.states.shape[2] for part in parts)
    lights = max(part.light_states.shape[2] for part in parts)
    padded = [_pad(part, agents, lights) for part in parts]
    tensors = {name: torch.cat([getattr(part, name) for part in padded]) for name in TENSORS}
    return Segments(**tensors, dt=parts[0].dt)


def scale(segments: Segments, factors: Float[Tensor, "2"]) -> Segments:
    """Scale x and y of the plane, and speeds; a negative factor of y mirrors it. Sizes stay."""
    size, sign = factors.abs().mean(), factors.sign().prod()
    change = torch.stack([factors[0], factors[1], sign, size]).to(segments.states)
    return replace(
        segments, states=segments.states * change, stop_lines=segments.stop_lines * change[:2]
    )


def _pad(part: Segments, agents: int, lights: int) -> Segments:
    more_agents = agents - part.states.shape[2]
    more_lights = lights - part.light_states.shape[2]
    return Segments(
        states=F.pad(part.states, (0, 0, 0, more_agents)),
        present=F.pad(part.present, (0, more_agents)),
        sizes=F.pad(part.sizes, (0, 0, 0, more_agents), value=1.0),
        layers=F.pad(part.layers, (0, more_agents)),
        controlled=F.pad(part.controlled, (0, more_agents)),
        places=part.places,
        stop_lines=F.pad(part.stop_lines, (0, 0, 0, 0, 0, more_lights)),
        light_states=F.pad(part.light_states, (0, more_lights), value=UNKNOWN),
        dt=part.dt,
    )


def _map_tensors(segments: Segments, change: Callable[[Tensor], Tensor]) -> Segments:
    changed = {name: change(getattr(segments, name)) for name in TENSORS}
    return replace(segments, **changed)  # type: ignore[arg-type]
