"""Pieces of recordings, as many tensors of one shape: what a model learns from and is judged by."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.errors import TracksError
from geoaim.lights import UNKNOWN
from geoaim.simulation.kinematics import step_bicycle
from geoaim.simulation.layers import KINDS
from geoaim.simulation.scene import Scene, scene_steps, states_of, step_seconds

VEHICLE, PERSON = 0, 1  # planes of the views that agents are painted in
NEAREST = 24  # agents that one segment keeps beside its ego
STILL = 1.0  # m: who moves less in a whole recording is parked, and nothing to learn from


@dataclass(frozen=True, eq=False)
class Segments:
    """S pieces of T steps, each with up to A agents and L lights around.

    Attributes:
        states: (S, T, A, 4) x, y, heading, speed; 0 while absent.
        present: (S, T, A).
        sizes: (S, A, 2) length and width, metres; 1 where there is nobody.
        planes: (S, A) `VEHICLE` or `PERSON`.
        controlled: (S, A) whom a model moves; they are there at all steps.
        lines: (S, L, 2, 2) stop lines.
        lights: (S, T, L) their states, as in `geoaim.lights`.
        seconds: of a step.
    """

    states: Float[Tensor, "S T A 4"]
    present: Bool[Tensor, "S T A"]
    sizes: Float[Tensor, "S A 2"]
    planes: Int[Tensor, "S A"]
    controlled: Bool[Tensor, "S A"]
    lines: Float[Tensor, "S L 2 2"]
    lights: Int[Tensor, "S T L"]
    seconds: float

    def __len__(self) -> int:
        return len(self.states)


TENSORS = [field.name for field in fields(Segments) if field.name != "seconds"]


def pick(segments: Segments, which: Tensor | slice) -> Segments:
    """Some of the segments."""
    return _each(segments, lambda tensor: tensor[which])


def segments_on(segments: Segments, device: torch.device | str) -> Segments:
    """The same segments on another device."""
    return _each(segments, lambda tensor: tensor.to(device))


def repeated(segments: Segments, samples: int) -> Segments:
    """Each segment so many times, one copy after the other."""
    return _each(segments, lambda tensor: tensor.repeat_interleave(samples, dim=0))


def joined(parts: Sequence[Segments]) -> Segments:
    """All segments in one, with places for agents and lights that only some of them need.

    Raises:
        ValueError: there are none, or their steps last differently.
    """
    if not parts or len({part.seconds for part in parts}) > 1:
        raise ValueError(f"{len(parts)} sets of segments of one step's length are needed")
    agents = max(part.states.shape[2] for part in parts)
    lights = max(part.lights.shape[2] for part in parts)
    padded = [_padded(part, agents, lights) for part in parts]
    whole = {name: torch.cat([getattr(part, name) for part in padded]) for name in TENSORS}
    return Segments(**whole, seconds=parts[0].seconds)


def cut_segments(
    scene: Scene, kind: str, *, steps: int, stride: int, joint: bool = False
) -> Segments:
    """Cut a scene into segments of agents of one kind, a start every so many steps.

    Args:
        scene: evenly sampled.
        kind: "vehicle" or "pedestrian"; others are around, and replay.
        steps: of each segment.
        stride: steps from start to start.
        joint: one segment for each start, in which all of the kind who are there at all its steps
            are controlled; otherwise one for each of them, alone and with his nearest neighbours.

    Raises:
        TracksError: nobody of the kind is there for so long and moves.
        ValueError: steps of the scene are not even.
    """
    if len(scene.times) < 2:
        raise TracksError(f"a scene of {len(scene.times)} steps; segments need {steps}")
    seconds = step_seconds(scene)
    if (scene.times.diff() - seconds).abs().max() > 0.01 * seconds:
        raise ValueError("the scene's steps are not even; resample the tracks")
    theirs = of_kind(scene, kind) & (_travelled(scene) > STILL)
    # (N, starts) who is there at all steps from each start on
    enough = steps <= len(scene.times)
    present = scene.present if enough else scene.present[:, :0].new_zeros(len(theirs), steps)
    whole = present.unfold(1, steps, stride).all(dim=2) & theirs[:, None]
    if not whole.any():
        longest = int(scene.present[theirs].sum(dim=1).max()) if theirs.any() else 0
        raise TracksError(
            f"no {kind} that moves is there for {steps} steps of {seconds:g} s; the longest is "
            f"there for {longest}"
        )
    parts = []
    for number in whole.any(dim=0).nonzero()[:, 0].tolist():
        piece = scene_steps(scene, slice(number * stride, number * stride + steps))
        who, controlled = (_everyone if joint else _nearest)(piece, whole[:, number])
        parts.append(_cut(piece, who, controlled, round(seconds, 6)))
    return joined(parts)


def cut_ahead(
    scene: Scene, kind: str, seconds: float, *, first: int, start: int, steps: int
) -> Segments:
    """One segment of everybody, in which all of a kind who are there at a step are controlled.

    Args:
        scene: evenly sampled; beyond its end others go straight on and lights stay.
        kind: "vehicle" or "pedestrian".
        seconds: of a step, which a scene of one step does not tell.
        first: the first step that is known.
        start: the last one; it is at this step that they have to be there.
        steps: after it.

    Raises:
        TracksError: nobody of the kind is there at that step.
    """
    controlled = of_kind(scene, kind) & scene.present[:, start]
    if not controlled.any():
        raise TracksError(f"no {kind} is there at {float(scene.times[start]):g} s")
    longer = _extended(scene, start + 1 + steps - len(scene.times), seconds)
    everybody = torch.arange(len(scene.ids), device=controlled.device)[None]
    piece = scene_steps(longer, slice(first, start + 1 + steps))
    segment = _cut(piece, everybody, controlled[None], seconds)
    present = segment.present.clone()
    present[:, start + 1 - first :, controlled] = True
    return replace(segment, present=present)


def of_kind(scene: Scene, kind: str) -> Bool[Tensor, "N"]:
    """Who is of a kind, by type."""
    return torch.tensor([name in KINDS[kind] for name in scene.types]).to(scene.present.device)


def shifted(segments: Segments, offset: Float[Tensor, "2"]) -> Segments:
    """The same segments elsewhere in the plane."""
    move = torch.cat([offset, offset.new_zeros(2)])
    return replace(segments, states=segments.states + move, lines=segments.lines + offset)


def scaled(segments: Segments, sides: Float[Tensor, "2"]) -> Segments:
    """The same in a plane whose x and y are so many times as long; mirrored by a negative y."""
    size, flip = sides.abs().mean(), sides.sign().prod()
    change = torch.stack([sides[0], sides[1], flip, size]).to(segments.states)
    return replace(segments, states=segments.states * change, lines=segments.lines * change[:2])


def _everyone(
    piece: Scene, whole: Bool[Tensor, "N"]
) -> tuple[Int[Tensor, "1 A"], Bool[Tensor, "1 A"]]:
    """All who are there at some step, in one segment."""
    who = piece.present.any(dim=1).nonzero()[:, 0]
    return who[None], whole[who][None]


def _nearest(
    piece: Scene, whole: Bool[Tensor, "N"]
) -> tuple[Int[Tensor, "S A"], Bool[Tensor, "S A"]]:
    """Each ego with those who come nearest to him, in a segment of his own.

    Nearest at any step, for these others replay: who comes later would be seen then all the same.
    """
    egos = whole.nonzero()[:, 0]
    places = piece.poses[..., :2]
    apart = (places[egos, None] - places).norm(dim=-1)
    apart = torch.where(piece.present, apart, torch.inf).amin(dim=2)
    apart[torch.arange(len(egos), device=egos.device), egos] = -1.0
    who = apart.argsort(dim=1)[:, : NEAREST + 1]
    return who, who == egos[:, None]


def _cut(
    piece: Scene, who: Int[Tensor, "S A"], controlled: Bool[Tensor, "S A"], seconds: float
) -> Segments:
    """Segments of all steps of a piece of a scene, each with its own agents."""
    states = torch.where(piece.present[..., None], states_of(piece), 0.0)
    count = len(who)
    return Segments(
        states=states[who].transpose(1, 2),
        present=piece.present[who].transpose(1, 2),
        sizes=piece.sizes[who],
        planes=torch.where(of_kind(piece, "vehicle"), VEHICLE, PERSON)[who],
        controlled=controlled,
        lines=piece.stop_lines.expand(count, -1, -1, -1),
        lights=piece.light_states.long().expand(count, -1, -1),
        seconds=seconds,
    )


def _extended(scene: Scene, steps: int, seconds: float) -> Scene:
    """The scene so many steps on: all go straight on as fast as they do, and lights stay."""
    if steps <= 0:
        return scene
    states, still = [states_of(scene)[:, -1]], scene.poses.new_zeros(len(scene.ids), 2)
    for _ in range(steps):
        states.append(step_bicycle(states[-1], still, scene.sizes[:, 0], seconds))
    after = torch.stack(states[1:], dim=1)
    later = torch.arange(1, steps + 1).to(scene.times) * seconds
    return replace(
        scene,
        times=torch.cat([scene.times, scene.times[-1] + later]),
        poses=torch.cat([scene.poses, after[..., :3]], dim=1),
        speeds=torch.cat([scene.speeds, after[..., 3]], dim=1),
        present=torch.cat([scene.present, scene.present[:, -1:].expand(-1, steps)], dim=1),
        light_states=torch.cat(
            [scene.light_states, scene.light_states[-1:].expand(steps, -1)], dim=0
        ),
    )


def _travelled(scene: Scene) -> Float[Tensor, "N"]:
    """The diagonal of the box in which an agent stays."""
    there = scene.present[..., None]
    places = scene.poses[..., :2]
    low = torch.where(there, places, torch.inf).amin(dim=1)
    high = torch.where(there, places, -torch.inf).amax(dim=1)
    return (high - low).norm(dim=1)


def _padded(part: Segments, agents: int, lights: int) -> Segments:
    more, lamps = agents - part.states.shape[2], lights - part.lights.shape[2]
    return Segments(
        states=F.pad(part.states, (0, 0, 0, more)),
        present=F.pad(part.present, (0, more)),
        sizes=F.pad(part.sizes, (0, 0, 0, more), value=1.0),
        planes=F.pad(part.planes, (0, more)),
        controlled=F.pad(part.controlled, (0, more)),
        lines=F.pad(part.lines, (0, 0, 0, 0, 0, lamps)),
        lights=F.pad(part.lights, (0, lamps), value=UNKNOWN),
        seconds=part.seconds,
    )


def _each(segments: Segments, change) -> Segments:  # type: ignore[no-untyped-def]
    return replace(segments, **{name: change(getattr(segments, name)) for name in TENSORS})
