"""Rollouts: what a model carries from one predicted step to the next."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.prediction.anchors import ANCHOR_SCALE_M
from geoaim.prediction.config import Config
from geoaim.prediction.observation import Controlled, index_controlled
from geoaim.prediction.plans import Plan
from geoaim.prediction.segments import Segments, mark_entries, repeat
from geoaim.rendering.ground import Ground
from geoaim.simulation.input_checks import check_shape
from geoaim.simulation.kinematics import MotionModel, agent_from_world

DT_TOLERANCE_S = 1e-3
MAX_ACTION = 4.0  # normalised; larger ground-truth actions are noise of headings at standstill


@dataclass(frozen=True, eq=False)
class Batch:
    """Segments with the index of their E controlled agents.

    Attributes:
        segments: states of all agents.
        ground: the map.
        controlled: index of the controlled agents.
        history: observed steps.
    """

    segments: Segments
    ground: Ground
    controlled: Controlled
    history: int

    @property
    def truth(self) -> Float[Tensor, "E T 4"]:
        """Recorded states of the controlled agents."""
        return self.segments.states[self.controlled.segment, self.controlled.agent]

    @property
    def sizes(self) -> Float[Tensor, "E 2"]:
        """Lengths and widths of the controlled agents."""
        return self.segments.sizes[self.controlled.segment, self.controlled.agent]

    @property
    def present(self) -> Bool[Tensor, "E T"]:
        """Presence of the controlled agents."""
        return self.segments.present[self.controlled.segment, self.controlled.agent]

    def find_moving(self, step: int) -> Bool[Tensor, "E 1"]:
        """Controlled agents that are there at a step and the next: those that a model moves."""
        return self.present[:, step : step + 2].all(dim=1, keepdim=True)

    def find_entering(self, step: int) -> Bool[Tensor, "E"]:
        """Controlled agents that enter at a predicted step: they were absent the step before."""
        if step < self.history:
            return torch.zeros_like(self.present[:, 0])
        return mark_entries(self.present[:, : step + 1], step)[:, 0]


@dataclass(frozen=True, eq=False)
class Rollout:
    """A simulation at one step: `ITRA.start` makes one, and `ITRA.step` the next one.

    Attributes:
        batch: the segments, each repeated for every sample, and the map.
        index: the step, an index of the segments' steps.
        states: (B, N, 4) x, y (m), heading (rad), speed (m/s) of all agents at that step.
        features: (E, F) views as they were last encoded.
        hidden: (E, H) hidden states of the GRU.
        anchor: (E, P, 2) the proposal that each agent follows, metres; None: there is none, or not
            yet.
        samples: rows of each segment, next to each other.
        latent: (E, Z) latents of the last step.
        curvature: (E,) of the arcs on which agents drive, 1/m, of a model that brakes for others.
        safe_speeds: (E, 3) speeds from which they could stop for those ahead, for those who cross
            and before red lights, as the last step began, m/s.
        plan: paths that agents follow, of a model that was trained on a place or that is steered.
        speeds: (E,) target speeds of agents that are steered, m/s; NaN: it has none.
        waits: (E,) who stands, or has just driven off, and had a reason to wait.
    """

    batch: Batch
    index: int
    states: Float[Tensor, "B N 4"]
    features: Float[Tensor, "E F"]
    hidden: Float[Tensor, "E H"]
    anchor: Float[Tensor, "E P 2"] | None = None
    samples: int = 1
    latent: Float[Tensor, "E Z"] | None = None
    curvature: Float[Tensor, "E"] | None = None
    safe_speeds: Float[Tensor, "E 3"] | None = None
    plan: Plan | None = None
    speeds: Float[Tensor, "E"] | None = None
    waits: Bool[Tensor, "E"] | None = None

    @property
    def pose(self) -> Float[Tensor, "E 4"]:
        """States of the controlled agents."""
        return self.states[self.batch.controlled.segment, self.batch.controlled.agent]

    @property
    def moving(self) -> Bool[Tensor, "E 1"]:
        """Controlled agents that are still there at the next step."""
        return self.batch.find_moving(self.index)

    @property
    def steered(self) -> Bool[Tensor, "E"]:
        """Controlled agents that follow a plan or have a target speed."""
        if self.plan is None or self.speeds is None:
            return torch.zeros_like(self.moving[:, 0])
        return self.plan.goes_on | self.speeds.isfinite()

    def place(self, agent: int, states: Float[Tensor, "B 4"]) -> "Rollout":
        """Put an agent elsewhere in all rows, as its own planner wants.

        Args:
            agent: column of the agent.
            states: (B, 4) x, y, heading, speed in each row.

        Raises:
            ValueError: the states have another shape.
        """
        check_shape("states", states, (len(self.states), 4))
        placed = self.states.clone()
        placed[:, agent] = states
        return replace(self, states=placed)


def repeat_rollout(rollout: Rollout, samples: int) -> Rollout:
    """Repeat a rollout for each of `samples` futures; the rows of a segment are neighbours."""
    one = rollout.batch
    number = one.segments.controlled.long()  # (B, N) row of each controlled agent
    number[one.controlled.segment, one.controlled.agent] = torch.arange(
        len(rollout.hidden), device=number.device
    )
    segments = repeat(one.segments, samples)
    batch = Batch(segments, one.ground, index_controlled(segments), one.history)
    row = number[batch.controlled.segment // samples, batch.controlled.agent]  # (E K,)
    return Rollout(
        batch=batch,
        index=rollout.index,
        states=rollout.states.repeat_interleave(samples, dim=0),
        features=rollout.features[row],
        hidden=rollout.hidden[row],
        samples=samples,
        curvature=None if rollout.curvature is None else rollout.curvature[row],
        waits=None if rollout.waits is None else rollout.waits[row],
    )


def gather_others(
    rollout: Rollout,
) -> tuple[Float[Tensor, "E N 4"], Float[Tensor, "E N 2"], Bool[Tensor, "E N"]]:
    """States and sizes of all agents of each controlled agent's segment, and who is another one."""
    segments, (row, agent) = rollout.batch.segments, rollout.batch.controlled.index
    there = segments.present[row, :, rollout.index]
    there = there & (torch.arange(there.shape[1], device=agent.device) != agent[:, None])
    return rollout.states[row], segments.sizes[row], there


def normalise_attributes(
    pose: Float[Tensor, "E 4"], sizes: Float[Tensor, "E 2"]
) -> Float[Tensor, "E 3"]:
    """Speed, length and width of agents, normalised."""
    return torch.cat([pose[:, 3:] / 10, sizes / 5], dim=1)


def encode_anchor(
    pose: Float[Tensor, "E 4"], anchor: Float[Tensor, "E P 2"], remaining: float
) -> Float[Tensor, "E _"]:
    """Encode a proposal in the agent's frame, and the share of steps that remain.

    Args:
        pose: (E, 4) states of the agents.
        anchor: (E, P, 2) the proposals, metres.
        remaining: the share.

    Returns:
        (E, 2 P + 1) normalised.
    """
    local = agent_from_world(pose[:, None], anchor) / ANCHOR_SCALE_M
    return torch.cat([local.flatten(1), torch.full_like(pose[:, :1], remaining)], dim=1)


def index_batch(config: Config, segments: Segments, ground: Ground, history: int) -> Batch:
    """Index the controlled agents of segments, and check that they fit a model.

    Args:
        config: of the model.
        segments: the segments.
        ground: the map.
        history: observed steps.

    Returns:
        The batch.

    Raises:
        ValueError: the segments do not fit.
    """
    batch = Batch(segments, ground, index_controlled(segments), history)
    check_fits(config, batch)
    return batch


def normalise_actions(motion: MotionModel, batch: Batch) -> Float[Tensor, "E t 2"]:
    """Compute the ground-truth actions of all steps, normalised."""
    before, after = batch.truth[:, :-1], batch.truth[:, 1:]
    actions = motion.inverse(before, after, batch.sizes[:, :1], batch.segments.dt)
    return (actions / actions.new_tensor(motion.scale)).clamp(-MAX_ACTION, MAX_ACTION)


def check_fits(config: Config, batch: Batch) -> None:
    """Raise ValueError where segments do not fit a model."""
    segments, history, total = batch.segments, batch.history, batch.segments.steps
    if abs(segments.dt - config.dt) > DT_TOLERANCE_S:
        raise ValueError(f"segments have a dt of {segments.dt:g} s, the model {config.dt:g} s")
    if not 1 <= history < total:
        raise ValueError(
            f"history is {history}, but the segments have {total} steps; give 1 to "
            f"{total - 1}, so that a step remains to predict"
        )
    if not segments.controlled.any():
        raise ValueError("no agent in these segments is controlled")
    if not config.num_anchors:
        return
    if (history, total - history) != (config.history, config.horizon):
        raise ValueError(
            f"history is {history} and the segments have {total} steps; the model's "
            f"proposals need a history of {config.history} and "
            f"{config.history + config.horizon} steps"
        )
    if not batch.present[:, :history].all():
        raise ValueError(f"proposals need agents that are present in all {history} observed steps")
