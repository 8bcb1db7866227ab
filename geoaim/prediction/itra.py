"""ITRA on image maps (Ścibior et al. 2021; Liu et al. 2023): a recurrent variational model.

At each step an agent sees a view b of the map with everybody on it, draws a latent z, acts, moves
by its kinematics, and remembers:

    z ~ N(0, I)    a = f_theta(b, z, h)    s' ~ N(f_kin(s, a), sigma)    h' = f_psi(h, b, a)

In training z comes from q_phi(z | b, a, h), where a is the action that was really taken, and the
evidence lower bound is optimised through kinematics and renderer. Only the egos are rolled out;
all others replay.

Beyond the paper, a model may have `modes`: at the last observed step it proposes so many plans (a
few points of the way ahead), of which one becomes a further input of f_theta. Plans are trained by
the best of them, so that they spread over what may happen as a best-of-K measure rewards.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from geoaim.prediction.encoders import make_encoder
from geoaim.prediction.segments import Segments, repeated
from geoaim.prediction.views import CHANNELS, Egos, egos_of, egos_see
from geoaim.simulation.ground import Ground, View
from geoaim.simulation.kinematics import (
    bicycle_action,
    bicycle_step,
    displacement_action,
    slide_step,
    unicycle_action,
    unicycle_step,
)

SCALES = {"bicycle": (2.0, 0.2), "unicycle": (1.0, 1.0), "slide": (0.5, 0.5)}  # usual actions
LIMIT = 4.0  # scales: true actions beyond are noise of headings at standstill
HASTE = 0.5  # s: metres that a metre a second is taken for
FACTS = 3  # speed, length, width
REACH = 10.0  # m, usual way to a plan's points


@dataclass(frozen=True)
class Config:
    """What a model is made of.

    Attributes:
        kind: whom it moves, "vehicle" or "pedestrian".
        seconds: of a step.
        motion: "bicycle", "unicycle", or "slide": positions alone, where no heading was measured.
        encoder: of views, "cnn" or "resnet18"; "none": the model sees nothing.
        size: pixels of a view's side.
        resolution: metres a pixel.
        every: steps from one look to the next; 1 as in the paper. In the steps between, what was
            seen last is taken to be there still.
        memory: width of the recurrent state.
        features: width of what a view is encoded to.
        latent: width of z.
        sigma: metres by which states may be off, in the likelihood.
        lever: metres that a radian of heading is taken for: half an agent's length.
        modes: plans to propose; 0 as in the paper.
        points: of a plan, evenly spaced in time, the last one at the end.
        ahead: steps that plans reach; 0 without plans.
    """

    kind: str
    motion: str
    seconds: float
    encoder: str = "cnn"
    size: int = 64
    resolution: float = 0.8
    every: int = 5
    memory: int = 128
    features: int = 96
    latent: int = 8
    sigma: float = 0.2
    lever: float = 2.0
    modes: int = 0
    points: int = 3
    ahead: int = 0

    @property
    def view(self) -> View:
        """The view of an agent."""
        return View(self.size, self.size, self.resolution)


@dataclass(frozen=True, eq=False)
class Losses:
    """Means over egos and predicted steps.

    Attributes:
        fit: negative log likelihood of the true states, without its constant.
        divergence: of the latents from the prior, nats.
        plan: metres from the best plan; 0 without plans.
    """

    fit: Float[Tensor, ""]
    divergence: Float[Tensor, ""]
    plan: Float[Tensor, ""]


@dataclass(frozen=True, eq=False)
class _Moment:
    """What an ego knows at a step, before it acts; f_theta and q_phi read it."""

    number: int
    pose: Float[Tensor, "E 4"]
    seen: Float[Tensor, "E F"]
    memory: Float[Tensor, "E M"]

    def context(self, facts: Float[Tensor, "E 3"]) -> Float[Tensor, "E C"]:
        return torch.cat([self.seen, self.memory, facts], dim=1)


Choice = Callable[[_Moment, Float[Tensor, "E C"]], Tensor]


class ITRA(nn.Module):
    """The networks. `forward` gives the losses of segments; see `sample` for predictions."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        context = config.features + config.memory + FACTS
        plan = 2 * config.points + 1 if config.modes else 0
        if config.encoder != "none":
            self.encoder = make_encoder(config.encoder, CHANNELS, config.size, config.features)
        self.remember = nn.GRUCell(config.features + 2 + FACTS, config.memory)
        self.act = _network(context + config.latent + plan, config.memory, 2)
        self.infer = _network(context + 2, config.memory, 2 * config.latent)
        if config.modes:
            self.propose = _network(context, 2 * config.memory, config.modes * 2 * config.points)
            self.weigh = _network(context, config.memory, config.modes)

    def forward(
        self, segments: Segments, ground: Ground, observed: int, generator: torch.Generator
    ) -> Losses:
        """The parts of the negative evidence lower bound, of all who are controlled.

        Args:
            segments: what happened.
            ground: the map.
            observed: first steps that are given.
            generator: of the noise of the latents.
        """
        egos = self._egos(segments, observed)
        truth = segments.states[egos.segment, :, egos.agent]
        done = self._actions(truth, segments, egos)
        levers = truth.new_tensor([1.0, 1.0, self.config.lever, HASTE]) / self.config.sigma
        divergences, plans = [], [truth.new_zeros(())]

        def choose(now: _Moment, context: Tensor) -> Tensor:
            mean, log_scale = self.infer(torch.cat([context, done[:, now.number]], 1)).chunk(2, 1)
            log_scale = log_scale.clamp(-5, 3)
            scale = log_scale.exp()
            divergences.append((0.5 * (mean**2 + scale**2 - 1) - log_scale).sum(dim=1))
            z = mean + scale * torch.randn(mean.shape, generator=generator, device=mean.device)
            if now.number == observed - 1 and self.config.modes:
                plans.append(self._plan_loss(now, context, truth, segments.seconds))
            return z

        way = (
            truth[:, self._plan_steps(observed, truth.shape[1]), :2] if self.config.modes else None
        )
        states = self._roll(
            segments, ground, egos, done, observed, choose, lambda now, context: way
        )
        found = states[egos.segment, observed:, egos.agent]
        error = _difference(found, truth[:, observed:]) * levers
        fit = 0.5 * error.square().sum(dim=2).mean()
        return Losses(fit, torch.stack(divergences, dim=1).mean(), plans[-1])

    @torch.no_grad()
    def sample(
        self,
        segments: Segments,
        ground: Ground,
        *,
        observed: int,
        samples: int,
        generator: torch.Generator,
        spread: float = 1.0,
    ) -> Float[Tensor, "S K T A 4"]:
        """Possible futures of all who are controlled, jointly; all others replay.

        Args:
            segments: whose first steps are known; of the controlled, later ones are not looked at.
            ground: the map.
            observed: steps that are known.
            samples: futures to draw.
            generator: of the noise.
            spread: of the latents: 1 as in training; 0: the most usual way to each plan.
        """
        many = repeated(segments, samples)
        egos = self._egos(many, observed)
        truth = many.states[egos.segment, :, egos.agent]
        done = self._actions(truth, many, egos)

        def choose(now: _Moment, context: Tensor) -> Tensor:
            size = (len(context), self.config.latent)
            return spread * torch.randn(size, generator=generator, device=context.device)

        def plan(now: _Moment, context: Tensor) -> Tensor | None:
            if not self.config.modes:
                return None
            plans = self._plans(now, context, truth.shape[1], segments.seconds)
            number = self._modes(context, egos.segment % samples)
            return plans[torch.arange(len(number), device=number.device), number]

        found = self._roll(many, ground, egos, done, observed, choose, plan)
        return found.view(len(segments), samples, *found.shape[1:])

    def _roll(
        self,
        segments: Segments,
        ground: Ground,
        egos: Egos,
        done: Float[Tensor, "E t 2"],
        observed: int,
        choose: Choice,
        plan: Callable[[_Moment, Tensor], Tensor | None],
    ) -> Float[Tensor, "S T A 4"]:
        """Let the egos live through the steps: they replay while observed, then they act."""
        config, total = self.config, segments.states.shape[1]
        sizes = segments.sizes[egos.segment, egos.agent]
        memory = sizes.new_zeros(len(sizes), config.memory)
        states, way = segments.states[:, 0], None
        seen = sizes.new_zeros(len(sizes), config.features)  # until the first look
        path = [states]
        for number in range(total - 1):
            pose = states[egos.segment, egos.agent]
            facts = torch.cat([pose[:, 3:] / 10, sizes / 5], dim=1)
            there = segments.present[egos.segment, number, egos.agent, None]
            if (number - observed + 1) % config.every == 0:
                look = self._see(segments, ground, egos, states, number)
                seen = torch.where(there, look, seen)
            if number < observed - 1:
                action = done[:, number]
                after = segments.states[egos.segment, number + 1, egos.agent]
            else:
                now = _Moment(number, pose, seen, memory)
                context = now.context(facts)
                if number == observed - 1:
                    way = plan(now, context)
                parts = [context, choose(now, context)]
                if way is not None:
                    parts.append(_plan_ahead(way, pose, (total - 1 - number) / total))
                action = LIMIT * torch.tanh(self.act(torch.cat(parts, dim=1)) / LIMIT)
                after = self._moved(pose, action, sizes[:, 0], segments.seconds)
            kept = self.remember(torch.cat([seen, action, facts], dim=1), memory)
            if number < observed - 1:  # who comes later has nothing to remember until then
                there = there & segments.present[egos.segment, number + 1, egos.agent, None]
            memory = torch.where(there, kept, memory)
            states = segments.states[:, number + 1].index_put((egos.segment, egos.agent), after)
            path.append(states)
        return torch.stack(path, dim=1)

    def _egos(self, segments: Segments, observed: int) -> Egos:
        total = segments.states.shape[1]
        if abs(segments.seconds - self.config.seconds) > 1e-3:
            raise ValueError(
                f"steps of {segments.seconds:g} s; the model was made for {self.config.seconds:g} s"
            )
        if not 1 <= observed < total:
            raise ValueError(f"{observed} of {total} steps are observed; 1 to {total - 1} can be")
        if self.config.modes and total - observed != self.config.ahead:
            raise ValueError(
                f"{total - observed} steps ahead; the model plans {self.config.ahead} of them"
            )
        if not segments.controlled.any():
            raise ValueError("nobody in these segments is controlled")
        return egos_of(segments)

    def _see(
        self, segments: Segments, ground: Ground, egos: Egos, states: Tensor, number: int
    ) -> Float[Tensor, "E F"]:
        if self.config.encoder == "none":
            return states.new_zeros(len(egos.agent), self.config.features)
        pictures = egos_see(self.config.view, ground, segments, egos, states, number)
        kind = pictures.device.type
        with torch.autocast(kind, dtype=torch.bfloat16, enabled=kind == "cuda"):
            return self.encoder((pictures - 0.5).to(memory_format=torch.channels_last)).to(
                pictures.dtype
            )

    def _actions(
        self, truth: Float[Tensor, "E T 4"], segments: Segments, egos: Egos
    ) -> Float[Tensor, "E t 2"]:
        """What was really done in each step, in usual actions."""
        before, after = truth[:, :-1], truth[:, 1:]
        lengths = segments.sizes[egos.segment, egos.agent, :1]
        if self.config.motion == "bicycle":
            found = bicycle_action(before, after, lengths, segments.seconds)
        elif self.config.motion == "unicycle":
            found = unicycle_action(before, after, segments.seconds)
        else:
            found = displacement_action(before, after)
        return (found / found.new_tensor(SCALES[self.config.motion])).clamp(-LIMIT, LIMIT)

    def _moved(
        self, pose: Float[Tensor, "E 4"], action: Tensor, lengths: Tensor, seconds: float
    ) -> Float[Tensor, "E 4"]:
        action = action * action.new_tensor(SCALES[self.config.motion])
        if self.config.motion == "bicycle":
            return bicycle_step(pose, action, lengths, seconds)
        if self.config.motion == "unicycle":
            return unicycle_step(pose, action, seconds)
        return slide_step(pose, action, seconds)

    def _plan_steps(self, observed: int, total: int) -> list[int]:
        ahead = total - observed
        return [
            observed - 1 + round(ahead * (k + 1) / self.config.points)
            for k in range(self.config.points)
        ]

    def _plans(
        self, now: _Moment, context: Tensor, total: int, seconds: float
    ) -> Float[Tensor, "E M P 2"]:
        """Proposed points of the way ahead, in the world: constant velocity, and what is off it."""
        shape = (-1, self.config.modes, self.config.points, 2)
        points = REACH * self.propose(context).view(shape)
        steps = self._plan_steps(now.number + 1, total)
        ahead = now.pose[:, 3:] * seconds * points.new_tensor([k - now.number for k in steps])
        straight = torch.stack([ahead, torch.zeros_like(ahead)], dim=-1)
        return _out_of(now.pose[:, None, None], points + straight[:, None])

    def _plan_loss(
        self, now: _Moment, context: Tensor, truth: Tensor, seconds: float
    ) -> Float[Tensor, ""]:
        """How far off the best plan is, all of it and its end; a little of all; its weight."""
        steps = self._plan_steps(now.number + 1, truth.shape[1])
        off = (self._plans(now, context, truth.shape[1], seconds) - truth[:, None, steps, :2]).norm(
            dim=-1
        )
        whole, best = off.mean(dim=2).min(dim=1)
        chance = nn.functional.cross_entropy(self.weigh(context), best)
        end = off[..., -1].min(dim=1).values
        return whole.mean() + end.mean() / 2 + off.mean() / 50 + chance / 10

    def _modes(self, context: Float[Tensor, "E C"], rank: Int[Tensor, "E"]) -> Int[Tensor, "E"]:
        """Which plan each sample follows: each of the likeliest ones once, then again."""
        order = self.weigh(context).argsort(dim=1, descending=True)
        return order.gather(1, (rank % self.config.modes)[:, None])[:, 0]


def _network(inputs: int, width: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(inputs, width),
        nn.ReLU(),
        nn.Linear(width, width),
        nn.ReLU(),
        nn.Linear(width, outputs),
    )


def _difference(found: Float[Tensor, "E t 4"], truth: Float[Tensor, "E t 4"]) -> Tensor:
    """States apart; headings the shorter way."""
    x, y, turn, speed = (found - truth).unbind(-1)
    turn = turn - 2 * torch.pi * torch.round(turn.detach() / (2 * torch.pi))
    return torch.stack([x, y, turn, speed], dim=-1)


def _plan_ahead(
    way: Float[Tensor, "E P 2"], pose: Float[Tensor, "E 4"], left: float
) -> Float[Tensor, "E C"]:
    """A plan's points as an ego sees them, and the share of the time that is left."""
    x, y = (way - pose[:, None, :2]).unbind(-1)
    cosine, sine = pose[:, None, 2].cos(), pose[:, None, 2].sin()
    points = torch.stack([x * cosine + y * sine, y * cosine - x * sine], dim=-1) / REACH
    return torch.cat([points.flatten(1), torch.full_like(points[:, 0, :1], left)], dim=1)


def _out_of(pose: Float[Tensor, "E 1 1 4"], points: Float[Tensor, "E M P 2"]) -> Tensor:
    """Points ahead and to the left of an ego, in the world."""
    ahead, left = points.unbind(-1)
    cosine, sine = pose[..., 2].cos(), pose[..., 2].sin()
    x, y = ahead * cosine - left * sine, ahead * sine + left * cosine
    return torch.stack([x, y], dim=-1) + pose[..., :2]
