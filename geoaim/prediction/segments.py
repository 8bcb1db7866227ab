"""Segments: pieces of recordings as tensors of one shape, for training and evaluation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.base.world import World
from geoaim.simulation.input_checks import check_traffic
from geoaim.simulation.simulator import Scenario
from geoaim.tracks.lights import UNKNOWN

VEHICLE, PEDESTRIAN = 0, 1  # layers of an observation; cyclists are drawn with pedestrians


@dataclass(frozen=True, eq=False)
class Segments:
    """B pieces of T steps, each with up to N agents and L lights.

    Attributes:
        states: (B, N, T, 4) x, y (m), heading (rad), speed (m/s); 0 while absent.
        present: (B, N, T) whether the agent is there.
        sizes: (B, N, 2) length and width, metres; 1 in padding.
        layers: (B, N) the layer that the agent is drawn in, `VEHICLE` or `PEDESTRIAN`.
        controlled: (B, N) whether the model controls the agent while it is there: it enters in its
            recorded state and leaves at its recorded time. Others replay.
        places: (B,) number of the segment's map in the ground of all maps.
        stop_lines: (B, L, 2, 2) both ends of each light's line, metres.
        light_states: (B, T, L) states, as in `geoaim.tracks.lights`.
        dt: time between steps, s.
        times: (B,) time of each segment's first step in its recording, s; NaN: not known.
        ids: names of the agents of each segment, without those of the padding; empty: not known.
        worlds: the planes of the metres, of all segments together; empty: not known.

    Raises:
        ValueError: a tensor has another shape than the states require.
    """

    states: Float[Tensor, "B N T 4"]
    present: Bool[Tensor, "B N T"]
    sizes: Float[Tensor, "B N 2"]
    layers: Int[Tensor, "B N"]
    controlled: Bool[Tensor, "B N"]
    places: Int[Tensor, "B"]
    stop_lines: Float[Tensor, "B L 2 2"]
    light_states: Int[Tensor, "B T L"]
    dt: float
    times: Float[Tensor, "B"] | None = None
    ids: tuple[tuple[str, ...], ...] = ()
    worlds: tuple[World, ...] = ()

    def __post_init__(self) -> None:
        lights = self.stop_lines.shape[1] if self.stop_lines.ndim == 4 else 0
        check_traffic(
            self.states,
            present=(self.present, "BNT"),
            sizes=(self.sizes, ("B", "N", 2)),
            layers=(self.layers, "BN"),
            controlled=(self.controlled, "BN"),
            places=(self.places, "B"),
            stop_lines=(self.stop_lines, ("B", lights, 2, 2)),
            light_states=(self.light_states, ("B", "T", lights)),
        )

    def __len__(self) -> int:
        return len(self.states)

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        """The tensors of one segment by name, as `torch.utils.data.DataLoader` collates them.

        `SegmentItems` adds the agent's frame and its view; `pick` selects several segments.
        """
        return {name: getattr(self, name)[index] for name in TENSORS}

    @property
    def agents(self) -> int:
        """N, the number of agents of each segment, with its padding."""
        return self.states.shape[1]

    @property
    def steps(self) -> int:
        """T, the number of steps of each segment."""
        return self.states.shape[2]


TENSORS = [f.name for f in fields(Segments) if f.name not in ("dt", "times", "ids", "worlds")]


def pick(segments: Segments, index: Tensor | slice) -> Segments:
    """Select some of the segments, by their rows or a mask of them."""
    rows = torch.arange(len(segments))[index.cpu() if isinstance(index, Tensor) else index]
    picked = _map_tensors(segments, lambda tensor: tensor[index])
    return _select_ids(picked, segments, rows.tolist())


def move_to(segments: Segments, device: torch.device | str) -> Segments:
    """Move segments to a device."""
    return _map_tensors(segments, lambda tensor: tensor.to(device))


def repeat(segments: Segments, samples: int) -> Segments:
    """Repeat each segment `samples` times, copies of one segment next to each other."""
    repeated = _map_tensors(segments, lambda tensor: tensor.repeat_interleave(samples, dim=0))
    rows = [row for row in range(len(segments)) for _ in range(samples)]
    return _select_ids(repeated, segments, rows)


def concat(parts: Sequence[Segments]) -> Segments:
    """Concatenate segments of equally many steps, padded to the most agents and lights.

    Raises:
        ValueError: there are none, or the time between their steps differs.
    """
    dts = sorted({part.dt for part in parts})
    if len(dts) != 1:
        stated = ", ".join(f"{dt:g}" for dt in dts) or "none"
        raise ValueError(f"dt of the segments, in s: {stated}; one or more of one dt are needed")
    agents = max(part.agents for part in parts)
    lights = max(part.light_states.shape[2] for part in parts)
    padded = [_pad(part, agents, lights) for part in parts]
    tensors = {name: torch.cat([getattr(part, name) for part in padded]) for name in TENSORS}
    times = [part.times for part in parts if part.times is not None]
    return Segments(
        **tensors,
        dt=parts[0].dt,
        times=torch.cat(times) if len(times) == len(parts) else None,
        ids=sum((part.ids for part in parts), ()) if all(part.ids for part in parts) else (),
        worlds=tuple(dict.fromkeys(world for part in parts for world in part.worlds)),
    )


def make_segment_scenario(segments: Segments) -> Scenario:
    """Make the simulator's scenario of segments."""
    pedestrian = segments.layers == PEDESTRIAN
    return Scenario(segments.states, segments.present, segments.sizes, pedestrian, segments.dt)


def control_present(segments: Segments, steps: slice) -> Segments:
    """Control only those of the controlled agents that are there at all of some steps."""
    there = segments.present[:, :, steps].all(dim=2)
    return replace(segments, controlled=segments.controlled & there)


def mark_steps_until_leaving(segments: Segments, history: int) -> Bool[Tensor, "B N t"]:
    """Mark the predicted steps at which an agent is there, since the last observed one on."""
    there = segments.present[:, :, history - 1 :]
    return there.int().cumprod(dim=2).bool()[:, :, 1:]


def mark_entries(present: Bool[Tensor, "*_ T"], history: int) -> Bool[Tensor, "*_ t"]:
    """Mark the predicted steps at which an agent is there and was not at the step before."""
    return present[..., history:] & ~present[..., history - 1 : -1]


def scale(segments: Segments, factors: Float[Tensor, "2"]) -> Segments:
    """Scale x and y of the plane, and speeds; a negative factor of y mirrors it. Sizes stay."""
    size, sign = factors.abs().mean(), factors.sign().prod()
    change = torch.stack([factors[0], factors[1], sign, size]).to(segments.states)
    return replace(
        segments, states=segments.states * change, stop_lines=segments.stop_lines * change[:2]
    )


def _pad(part: Segments, agents: int, lights: int) -> Segments:
    more_agents, more_lights = agents - part.agents, lights - part.light_states.shape[2]
    return replace(
        part,
        states=F.pad(part.states, (0, 0, 0, 0, 0, more_agents)),
        present=F.pad(part.present, (0, 0, 0, more_agents)),
        sizes=F.pad(part.sizes, (0, 0, 0, more_agents), value=1.0),
        layers=F.pad(part.layers, (0, more_agents)),
        controlled=F.pad(part.controlled, (0, more_agents)),
        stop_lines=F.pad(part.stop_lines, (0, 0, 0, 0, 0, more_lights)),
        light_states=F.pad(part.light_states, (0, more_lights), value=UNKNOWN),
    )


def _map_tensors(segments: Segments, change: Callable[[Tensor], Tensor]) -> Segments:
    names = TENSORS if segments.times is None else [*TENSORS, "times"]
    changed = {name: change(getattr(segments, name)) for name in names}
    return replace(segments, **changed)  # type: ignore[arg-type]


def _select_ids(segments: Segments, source: Segments, rows: Sequence[int]) -> Segments:
    return replace(segments, ids=tuple(source.ids[row] for row in rows) if source.ids else ())
