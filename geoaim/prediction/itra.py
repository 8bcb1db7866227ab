"""ITRA on image maps (Ścibior et al. 2021; Liu et al. 2023): a recurrent variational model.

At each step an agent sees a view b of the map with everybody on it, draws a latent z, acts, moves
by its kinematics, and remembers:

    z ~ N(0, I)    a = f_theta(b, z, h)    s' ~ N(f_kin(s, a), sigma)    h' = f_psi(h, b, a)

In training z comes from q_phi(z | b, a, h), where a is the action that was really taken, and the
evidence lower bound is optimised through kinematics and renderer. Only the egos are rolled out;
all others replay.

Beyond the paper, a model may have `modes`: at the last observed step it proposes so many plans, of
which one becomes a further input of f_theta (see `plans`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from geoaim.prediction.encoders import make_encoder
from geoaim.prediction.plans import JITTER, REACH, Planner, network, nth_plan, plan_loss
from geoaim.prediction.segments import Segments, repeated
from geoaim.prediction.views import CHANNELS, Egos, Sight, egos_of, egos_see, unlike_underfoot
from geoaim.simulation.ground import Ground
from geoaim.simulation.kinematics import MOTION_MODELS, agent_from_world, wrap_angle
from geoaim.simulation.lines import BAR

LIMIT = 4.0  # scales: true actions beyond are noise of headings at standstill
HASTE = 0.5  # s: metres that a metre a second is taken for
FACTS = 3  # speed, length, width


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
        unlike: whether views also show how unlike the ground is to that under the agent.
        bar: metres that a light's bar is wide, on its stop line.
        every: steps from one look to the next; 1 as in the paper. In the steps between, what was
            seen last is taken to be there still.
        memory: width of the recurrent state.
        features: width of what a view is encoded to.
        latent: width of z.
        sigma: metres by which states may be off, in the likelihood.
        lever: metres that a radian of heading is taken for: half an agent's length.
        modes: plans to propose; 0 as in the paper.
        points: of a plan, evenly spaced in time, the last one at the end.
        known: steps that are known when plans are made; 0 without plans.
        ahead: steps that plans reach; 0 without plans.
    """

    kind: str
    motion: str
    seconds: float
    encoder: str = "cnn"
    size: int = 64
    resolution: float = 0.8
    unlike: bool = False
    bar: float = BAR
    every: int = 5
    memory: int = 128
    features: int = 96
    latent: int = 8
    sigma: float = 0.2
    lever: float = 2.0
    modes: int = 0
    points: int = 3
    known: int = 0
    ahead: int = 0

    @property
    def view(self) -> Sight:
        """The view of an agent."""
        return Sight(self.size, self.size, self.resolution, self.bar)


@dataclass(frozen=True, eq=False)
class Losses:
    """Means over egos and predicted steps.

    Attributes:
        fit: negative log likelihood of the true states, without its constant.
        divergence: of the latents from the prior, nats.
        plan: metres that the plans which learn are off, and a little for their logits; 0 without.
    """

    fit: Float[Tensor, ""]
    divergence: Float[Tensor, ""]
    plan: Float[Tensor, ""]


@dataclass(frozen=True, eq=False)
class _Moment:
    """A step before which egos act, and all that they know; f_theta and q_phi read the context."""

    number: int
    pose: Float[Tensor, "E 4"]
    seen: Float[Tensor, "E F"]
    context: Float[Tensor, "E C"]


@dataclass(frozen=True, eq=False)
class _Mind:
    """What egos saw last, and what they remember."""

    seen: Float[Tensor, "E F"]
    memory: Float[Tensor, "E M"]


Choice = Callable[[_Moment], Tensor]
Plan = Callable[[_Moment], Tensor | None]


class ITRA(nn.Module):
    """The networks. `forward` gives the losses of segments; see `sample` for predictions."""

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.motion = MOTION_MODELS[config.motion]
        context = config.features + config.memory + FACTS
        plan = 2 * config.points + 1 if config.modes else 0
        if config.encoder != "none":
            channels = CHANNELS + config.unlike
            self.encoder = make_encoder(config.encoder, channels, config.size, config.features)
        self.remember = nn.GRUCell(config.features + 2 + FACTS, config.memory)
        self.act = network(context + config.latent + plan, config.memory, 2)
        self.infer = network(context + 2, config.memory, 2 * config.latent)
        if config.modes:
            self.plan = Planner(
                config.known,
                config.ahead,
                config.modes,
                config.points,
                config.features,
                config.memory,
            )

    def forward(
        self,
        segments: Segments,
        ground: Ground,
        observed: int,
        generator: torch.Generator,
        winners: int = 1,
    ) -> Losses:
        """The parts of the negative evidence lower bound, of all who are controlled.

        Args:
            segments: what happened.
            ground: the map.
            observed: first steps that are given.
            generator: of all noise.
            winners: plans that learn from each ego, its best ones.
        """
        egos = self._egos(segments, observed)
        truth = segments.states[egos.segment, :, egos.agent]
        done = self._actions(truth, segments, egos)
        levers = truth.new_tensor([1.0, 1.0, self.config.lever, HASTE]) / self.config.sigma
        divergences, plans = [], [truth.new_zeros(())]

        def choose(now: _Moment) -> Tensor:
            known = torch.cat([now.context, done[:, now.number]], dim=1)
            mean, log_scale = self.infer(known).chunk(2, 1)
            log_scale = log_scale.clamp(-5, 3)
            scale = log_scale.exp()
            divergences.append((0.5 * (mean**2 + scale**2 - 1) - log_scale).sum(dim=1))
            return mean + scale * torch.randn(mean.shape, generator=generator, device=mean.device)

        def plan(now: _Moment) -> Tensor | None:
            if not self.config.modes:
                return None
            past = truth[:, :observed, :2]
            past = past + JITTER * torch.randn(past.shape, generator=generator, device=past.device)
            found, logits = self.plan(now.pose, past, now.seen)
            way = truth[:, [observed - 1 + k for k in self.plan.steps], :2]
            plans.append(plan_loss(found, logits, way, winners))
            return way

        mind = self._watch(segments, ground, egos, done, observed)
        states = self._roll(segments, ground, egos, mind, observed, choose, plan)
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
        egos = self._egos(segments, observed)
        truth = segments.states[egos.segment, :, egos.agent]
        done = self._actions(truth, segments, egos)
        watched = self._watch(segments, ground, egos, done, observed)
        numbers = segments.controlled.long()
        numbers[egos.segment, egos.agent] = torch.arange(len(truth), device=truth.device)
        many = repeated(segments, samples)
        all_egos = egos_of(many)
        which = numbers[all_egos.segment // samples, all_egos.agent]
        mind = _Mind(watched.seen[which], watched.memory[which])

        def choose(now: _Moment) -> Tensor:
            size = (len(which), self.config.latent)
            return spread * torch.randn(size, generator=generator, device=truth.device)

        def plan(now: _Moment) -> Tensor | None:
            if not self.config.modes:
                return None
            past = truth[which, :observed, :2]
            plans, logits = self.plan(now.pose, past, now.seen)
            return nth_plan(plans, logits, all_egos.segment % samples)

        found = self._roll(many, ground, all_egos, mind, observed, choose, plan)
        return found.view(len(segments), samples, *found.shape[1:])

    def _watch(
        self,
        segments: Segments,
        ground: Ground,
        egos: Egos,
        done: Float[Tensor, "E t 2"],
        observed: int,
    ) -> _Mind:
        """What egos remember when they have replayed all steps that are given but the last."""
        config, sizes = self.config, segments.sizes[egos.segment, egos.agent]
        count = len(sizes)
        mind = _Mind(sizes.new_zeros(count, config.features), sizes.new_zeros(count, config.memory))
        for number in range(observed - 1):
            states = segments.states[:, number]
            seen = self._look(segments, ground, egos, states, number, observed, mind.seen)
            facts = _facts(states[egos.segment, egos.agent], sizes)
            kept = self.remember(torch.cat([seen, done[:, number], facts], dim=1), mind.memory)
            both = segments.present[egos.segment, number : number + 2, egos.agent]
            there = both.all(dim=1, keepdim=True)  # who comes later has nothing to remember yet
            mind = _Mind(seen, torch.where(there, kept, mind.memory))
        return mind

    def _roll(
        self,
        segments: Segments,
        ground: Ground,
        egos: Egos,
        mind: _Mind,
        observed: int,
        choose: Choice,
        plan: Plan,
    ) -> Float[Tensor, "S T A 4"]:
        """Let the egos act from the last step that is given on; all others replay."""
        total, sizes = segments.states.shape[1], segments.sizes[egos.segment, egos.agent]
        states, way, seen, memory = segments.states[:, observed - 1], None, mind.seen, mind.memory
        path = list(segments.states[:, :observed].unbind(dim=1))
        for number in range(observed - 1, total - 1):
            pose = states[egos.segment, egos.agent]
            facts = _facts(pose, sizes)
            seen = self._look(segments, ground, egos, states, number, observed, seen)
            now = _Moment(number, pose, seen, torch.cat([seen, memory, facts], dim=1))
            if number == observed - 1:
                way = plan(now)
            parts = [now.context, choose(now)]
            if way is not None:
                left = torch.full_like(pose[:, :1], (total - 1 - number) / total)
                points = agent_from_world(pose[:, None], way) / REACH
                parts.append(torch.cat([points.flatten(1), left], dim=1))
            action = LIMIT * torch.tanh(self.act(torch.cat(parts, dim=1)) / LIMIT)
            after = self._moved(pose, action, sizes[:, 0], segments.seconds)
            memory = self.remember(torch.cat([seen, action, facts], dim=1), memory)
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
        plans = (self.config.known, self.config.ahead)
        if self.config.modes and (observed, total - observed) != plans:
            raise ValueError(
                f"{observed} of {total} steps known; the model plans {plans[1]} after {plans[0]}"
            )
        if not segments.controlled.any():
            raise ValueError("nobody in these segments is controlled")
        egos = egos_of(segments)
        if self.config.modes and not segments.present[egos.segment, :observed, egos.agent].all():
            raise ValueError(
                f"plans need everybody who is moved to be there in all {observed} steps"
            )
        return egos

    def _look(
        self,
        segments: Segments,
        ground: Ground,
        egos: Egos,
        states: Float[Tensor, "S A 4"],
        number: int,
        observed: int,
        seen: Float[Tensor, "E F"],
    ) -> Float[Tensor, "E F"]:
        """What is seen now, or was seen last: between two looks, and by who is not there."""
        if self.config.encoder == "none" or (number - observed + 1) % self.config.every:
            return seen
        pictures = egos_see(self.config.view, ground, segments, egos, states, number)
        if self.config.unlike:
            pictures = torch.cat([pictures, unlike_underfoot(pictures)], dim=1)
        kind = pictures.device.type
        with torch.autocast(kind, dtype=torch.bfloat16, enabled=kind == "cuda"):
            found = self.encoder((pictures - 0.5).to(memory_format=torch.channels_last))
        there = segments.present[egos.segment, number, egos.agent, None]
        return torch.where(there, found.to(seen), seen)

    def _actions(
        self, truth: Float[Tensor, "E T 4"], segments: Segments, egos: Egos
    ) -> Float[Tensor, "E t 2"]:
        """What was really done in each step, in usual actions."""
        before, after = truth[:, :-1], truth[:, 1:]
        lengths = segments.sizes[egos.segment, egos.agent, :1]
        found = self.motion.inverse(before, after, lengths, segments.seconds)
        return (found / found.new_tensor(self.motion.scale)).clamp(-LIMIT, LIMIT)

    def _moved(
        self, pose: Float[Tensor, "E 4"], action: Tensor, lengths: Tensor, seconds: float
    ) -> Float[Tensor, "E 4"]:
        action = action * action.new_tensor(self.motion.scale)
        return self.motion.step(pose, action, lengths, seconds)


def _facts(pose: Float[Tensor, "E 4"], sizes: Float[Tensor, "E 2"]) -> Float[Tensor, "E 3"]:
    """What an ego knows of itself without looking."""
    return torch.cat([pose[:, 3:] / 10, sizes / 5], dim=1)


def _difference(found: Float[Tensor, "E t 4"], truth: Float[Tensor, "E t 4"]) -> Tensor:
    """States apart; headings the shorter way."""
    x, y, turn, speed = (found - truth).unbind(-1)
    return torch.stack([x, y, wrap_angle(turn), speed], dim=-1)
