"""ITRA on image maps: a conditional variational recurrent neural network (CVRNN).

Ścibior et al. 2021, on the maps of Liu et al. 2023. At each step t an observation b_t is rendered
around each controlled agent, a latent z_t is drawn, an action a_t is decoded, the agent moves by
its kinematic model f_kin, and the hidden state h_t of a GRU is updated:

    z_t ~ N(0, I)        a_t = f_theta(b_t, z_t, h_{t-1})        s_{t+1} ~ N(f_kin(s_t, a_t), sigma)
    h_t = f_psi(h_{t-1}, b_t, a_t)

Samples take the mean of s_{t+1}: noise at each step would move a standing car by a metre.
In training z_t comes from the posterior q_phi(z_t | b_t, a_t, h_{t-1}), where a_t is the
ground-truth action, and the evidence lower bound is maximized through kinematics and renderer.
All other agents replay their ground truth. Agents enter and leave as recorded.

Beyond the paper, a model may have trajectory proposals (`anchors`): at the last observed step it
proposes `num_anchors` of them, and each sample follows one, as a further input of f_theta.

A model that was trained on a place holds a network of it, which `draw_covering` uses.

Shapes: B segments, K samples, N agents, T steps, E controlled agents of all segments, F features,
H hidden state, Z latent, A proposals, P points of a proposal.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from geoaim.prediction import controllers
from geoaim.prediction.anchors import (
    HISTORY_NOISE_M,
    AnchorHead,
    compute_anchor_loss,
    select_anchor,
)
from geoaim.prediction.bound import Losses, compute_nll, draw_posterior
from geoaim.prediction.config import Config
from geoaim.prediction.neighbours import split_views
from geoaim.prediction.networks import build_cnn, build_mlp
from geoaim.prediction.observation import (
    CHANNELS,
    Controlled,
    compute_surface_contrast,
    index_controlled,
    render_observation,
)
from geoaim.prediction.plain import PlainNetwork
from geoaim.prediction.plans import Goal
from geoaim.prediction.rollouts import (
    MAX_ACTION,
    Batch,
    Rollout,
    encode_anchor,
    index_batch,
    normalise_actions,
    normalise_attributes,
    repeat_rollout,
)
from geoaim.prediction.segments import Segments
from geoaim.rendering.ground import Ground
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.simulation.input_checks import check_shape
from geoaim.simulation.kinematics import MOTION_MODELS

if TYPE_CHECKING:
    from geoaim.prediction.familiarity import KnownViews

ATTRIBUTES = 3  # speed, length and width


class ITRA(nn.Module):
    """The model. `forward` computes the losses of segments, `sample` draws futures.

    Args:
        config: its hyperparameters.
    """

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.known_views: KnownViews | None = None  # of a trained model with observations
        self.own_place: PlainNetwork | None = None  # of a model that was trained on a place
        self.motion = MOTION_MODELS[config.motion]
        self.controllers = [controllers.follow]
        if config.brakes:
            self.controllers += [controllers.start, controllers.brake]
        context = config.feature_size + config.hidden_size + ATTRIBUTES
        anchor = 2 * config.anchor_points + 1 if config.num_anchors else 0
        if config.use_observations:
            channels = CHANNELS + config.surface_contrast
            self.encoder = build_cnn(channels, config.view_size, config.feature_size)
        # f_psi, f_theta and q_phi; the prior is a standard normal distribution
        self.update_hidden = nn.GRUCell(config.feature_size + 2 + ATTRIBUTES, config.hidden_size)
        self.decode_action = build_mlp(context + config.latent_size + anchor, config.hidden_size, 2)
        self.posterior = build_mlp(context + 2, config.hidden_size, 2 * config.latent_size)
        if config.num_anchors:
            self.anchors = AnchorHead(config)
        if config.brakes and config.motion != "bicycle":
            raise ValueError(f"brakes=True is for vehicles; the motion is {config.motion!r}")

    def forward(
        self,
        segments: Segments,
        ground: Ground,
        history: int,
        generator: torch.Generator,
        top_k: int = 1,
    ) -> Losses:
        """Compute the parts of the negative evidence lower bound over all controlled agents.

        Args:
            segments: the ground truth.
            ground: the map, prefiltered (`prefilter_ground`) as in the result of `make_dataset`.
            history: observed steps.
            generator: source of all noise, on the segments' device.
            top_k: proposals of each agent that are trained, its best ones.

        Returns:
            The losses, to be weighted and summed.

        Raises:
            ValueError: the segments do not fit the model.
        """
        batch = index_batch(self.config, segments, ground, history)
        truth, actions = batch.truth, normalise_actions(self.motion, batch)
        rollout, anchor_loss = self._start(batch, actions), truth.new_zeros(())
        predicted, kl, held = [], [], self.config.latent_steps
        for step in range(history - 1, segments.steps - 1):
            rollout, context = self._look(rollout)
            if self.config.num_anchors and step == history - 1:
                anchor, anchor_loss = self._train_anchors(rollout, generator, top_k)
                rollout = replace(rollout, anchor=anchor)
            if (step - history + 1) % held == 0:
                taken = actions[:, step : step + held].mean(dim=1)
                posterior = self.posterior(torch.cat([context, taken], dim=1))
                latent, divergence = draw_posterior(posterior, generator)
                kl.append(divergence / held)
            action = self._decode(rollout, context, latent)
            rollout = self._move(self._remember(rollout, context, action), action)
            predicted.append(rollout.pose)
        nll = compute_nll(self.config, torch.stack(predicted, dim=1), truth[:, history:])
        return Losses(nll, torch.stack(kl, dim=1).mean(), anchor_loss)

    @torch.no_grad()
    def sample(  # noqa: PLR0913  (what is sampled, and how)
        self,
        segments: Segments,
        ground: Ground,
        *,
        history: int,
        samples: int,
        generator: torch.Generator,
        latent_scale: float = 1.0,
        goals: Mapping[str, Goal] | None = None,
        plans: Float[Tensor, "B K N t 4"] | None = None,
    ) -> Float[Tensor, "B K N T 4"]:
        """Sample joint futures of all controlled agents; all others replay.

        It is `start`, then `step` in a loop, with the same samples for the same seed.

        Args:
            segments: segments, whose first steps are observed. Of controlled agents' later steps,
                only when they leave is used, and when and in which state they enter.
            ground: the map. It is prefiltered for the model's views here unless that was done
                before (`prefilter_ground`), which saves time over many calls.
            history: observed steps.
            samples: K futures to draw.
            generator: source of the noise, on the segments' device.
            latent_scale: a further factor on latents; 0: all samples are alike.
            goals: way points and target speeds of agents, by the names in `segments.ids`.
            plans: states that agents follow in each sample after the last observed step.

        Returns:
            States x, y (m), heading (rad), speed (m/s) of all agents at all steps, the observed
            ones included.

        Raises:
            ValueError: the segments do not fit the model.
        """
        given: dict[str, Any] = {"history": history, "samples": samples, "goals": goals}
        rollout = self.start(segments, ground, plans=plans, **given)
        return self._roll_out(rollout, lambda now: self.draw_latent(now, generator, latent_scale))

    def decode_latents(
        self,
        segments: Segments,
        ground: Ground,
        latents: Float[Tensor, "B K N t Z"],
        *,
        history: int,
        gradients: bool = False,
    ) -> Float[Tensor, "B K N T 4"]:
        """Compute the futures of given latents, such as those by which an agent reaches a goal.

        Args:
            segments: as in `sample`.
            ground: as in `sample`.
            latents: (B, K, N, t, Z) latents of K futures at the t predicted steps; those of agents
                that are not controlled are not used.
            history: observed steps.
            gradients: whether gradients pass, to latents, states, the texture and the weights.

        Returns:
            States as in `sample`.

        Raises:
            ValueError: the segments do not fit the model, or latents have another shape.
        """
        samples = latents.shape[1] if latents.ndim > 1 else 1
        horizon = segments.steps - history
        shape = len(segments), samples, segments.agents, horizon, self.config.latent_size
        check_shape("latents", latents, shape)
        with torch.set_grad_enabled(gradients):
            rollout = self.start(segments, ground, history=history, samples=samples)
            rollout = replace(rollout, plan=None)
            index = rollout.batch.controlled.segment, rollout.batch.controlled.agent
            chosen = latents.flatten(0, 1)[index]  # (E, t, Z)
            return self._roll_out(rollout, lambda now: chosen[:, now.index - history + 1])

    def start(
        self,
        segments: Segments,
        ground: Ground,
        *,
        history: int,
        samples: int = 1,
        goals: Mapping[str, Goal] | None = None,
        plans: Float[Tensor, "B K N t 4"] | None = None,
    ) -> Rollout:
        """Encode the observed steps of segments, for `step` to go on from.

        Args:
            segments: as in `sample`. Agents that someone else moves are not `controlled`.
            ground: the map, as in `sample`.
            history: observed steps.
            samples: K futures of each segment, which are rows next to each other.
            goals: way points and target speeds of agents, by the names in `segments.ids`.
            plans: as in `sample`.

        Returns:
            The rollout at the last observed step.

        Raises:
            ValueError: the segments do not fit the model, or a goal's agent is not controlled.
        """
        ground = prefilter_ground(ground, self.config.resolution)
        one = index_batch(self.config, segments, ground, history)
        actions = normalise_actions(self.motion, one)
        rollout = self._start(one, actions)
        if self.config.brakes:
            rollout = controllers.prepare(rollout, self.scale_action(actions))
        rollout = repeat_rollout(rollout, samples)
        given = rollout, segments, plans, goals or {}
        return controllers.make_plans(*given, bicycle=self.config.motion == "bicycle")

    def draw_latent(
        self, rollout: Rollout, generator: torch.Generator, scale: float = 1.0
    ) -> Float[Tensor, "E Z"]:
        """Draw the latents of a step of all controlled agents: the prior, scaled.

        With `latent_steps`, those of the step before are kept for as long.
        """
        since = rollout.index - rollout.batch.history + 1
        if rollout.latent is not None and since % self.config.latent_steps:
            return rollout.latent
        shape = len(rollout.hidden), self.config.latent_size
        noise = torch.randn(shape, generator=generator, device=rollout.hidden.device)
        return scale * self.config.latent_scale * noise

    def step(self, rollout: Rollout, latent: Float[Tensor, "E Z"] | None = None) -> Rollout:
        """Move all controlled agents by one step; all others are where the segments have them.

        Nothing inside the model changes; to let somebody else drive an agent, replace its states in
        the result (`Rollout.place`) before the next step, which the others then see.

        Args:
            rollout: from `start` or `step`.
            latent: (E, Z) latents of the controlled agents (`draw_latent`); None: the prior's mean.

        Returns:
            The rollout at the next step.

        Raises:
            ValueError: the segments end at this step, or latents have another shape.
        """
        action, rollout = self.act(rollout, latent)
        return self._move(rollout, action)

    def act(
        self, rollout: Rollout, latent: Float[Tensor, "E Z"] | None = None
    ) -> tuple[Float[Tensor, "E 2"], Rollout]:
        """Decode the actions of all controlled agents, and update what the model remembers.

        Args:
            rollout: from `start` or `step`.
            latent: (E, Z) latents of the controlled agents (`draw_latent`); None: the prior's mean.

        Returns:
            (E, 2) actions, normalised; and the rollout, whose agents have not yet moved.

        Raises:
            ValueError: as in `step`.
        """
        if rollout.index + 1 >= rollout.batch.segments.steps:
            raise ValueError(f"the segments end at step {rollout.index}; none is left to predict")
        shape = len(rollout.hidden), self.config.latent_size
        latent = rollout.hidden.new_zeros(shape) if latent is None else latent
        check_shape("latent", latent, shape)
        rollout, context = self._look(rollout)
        if self.config.num_anchors and rollout.anchor is None:
            past = rollout.batch.truth[:, : rollout.batch.history, :2]
            anchors, logits = self.anchors(rollout.pose, past, rollout.features)
            rank = rollout.batch.controlled.segment % rollout.samples
            rollout = replace(rollout, anchor=select_anchor(anchors, logits, rank))
        action = self.scale_action(self._decode(rollout, context, latent))
        rollout = controllers.watch(rollout)
        for control in self.controllers:
            rollout, action = control(rollout, action)
        rollout = controllers.remember_arc(rollout, action)
        action = (action / action.new_tensor(self.motion.scale)).clamp(-MAX_ACTION, MAX_ACTION)
        return action, replace(self._remember(rollout, context, action), latent=latent)

    def scale_action(self, action: Float[Tensor, "*E 2"]) -> Float[Tensor, "*E 2"]:
        """Convert normalised actions to those of the motion model, such as m/s² and radians."""
        return action * action.new_tensor(self.motion.scale)

    def encode_views(self, segments: Segments, ground: Ground, step: int) -> Float[Tensor, "E F"]:
        """Encode the views of all controlled agents at a step.

        Args:
            segments: segments whose controlled agents are present at the step.
            ground: the map, prefiltered.
            step: index of the step.

        Returns:
            The features of each view.
        """
        batch = Batch(segments, ground, index_controlled(segments), step + 1)
        none = segments.sizes.new_zeros(len(batch.controlled.agent), self.config.feature_size)
        return self._update_features(batch, segments.states[:, :, step], step, none)

    def _start(self, batch: Batch, actions: Float[Tensor, "E t 2"]) -> Rollout:
        """Replay all observed steps but the last one, and update hidden states on the way."""
        sizes = batch.sizes
        features = sizes.new_zeros(len(sizes), self.config.feature_size)
        hidden = sizes.new_zeros(len(sizes), self.config.hidden_size)
        for step in range(batch.history - 1):
            states = batch.segments.states[:, :, step]  # (B, N, 4)
            features = self._update_features(batch, states, step, features)  # (E, F)
            attributes = normalise_attributes(batch.truth[:, step], sizes)
            inputs = torch.cat([features, actions[:, step], attributes], dim=1)  # (E, F + 2 + 3)
            updated = self.update_hidden(inputs, hidden)  # (E, H)
            # the hidden state of an agent that enters later stays zero until then
            hidden = torch.where(batch.find_moving(step), updated, hidden)
        last = batch.history - 1
        states = batch.segments.states[:, :, last]
        return Rollout(batch, last, states, features, hidden)

    def _roll_out(
        self, rollout: Rollout, draw: Callable[[Rollout], Float[Tensor, "E Z"]]
    ) -> Float[Tensor, "B K N T 4"]:
        """Step to the end by the latents that are drawn; the observed steps come first."""
        path = list(rollout.batch.segments.states[:, :, : rollout.batch.history].unbind(2))
        for _ in range(rollout.index + 1, rollout.batch.segments.steps):
            rollout = self.step(rollout, draw(rollout))
            path.append(rollout.states)
        states = torch.stack(path, dim=2)
        return states.view(-1, rollout.samples, *states.shape[1:])

    def _look(self, rollout: Rollout) -> tuple[Rollout, Float[Tensor, "E C"]]:
        """Encode the views; also gives the context of all decisions."""
        index, before = rollout.index, rollout.features
        features = self._update_features(rollout.batch, rollout.states, index, before)  # (E, F)
        attributes = normalise_attributes(rollout.pose, rollout.batch.sizes)  # (E, 3)
        context = torch.cat([features, rollout.hidden, attributes], dim=1)  # (E, F + H + 3)
        return replace(rollout, features=features), context

    def _decode(
        self, rollout: Rollout, context: Float[Tensor, "E C"], latent: Float[Tensor, "E Z"]
    ) -> Float[Tensor, "E 2"]:
        """Decode normalised actions."""
        inputs, total = [context, latent], rollout.batch.segments.steps
        if rollout.anchor is not None:
            remaining = (total - 1 - rollout.index) / total
            inputs.append(encode_anchor(rollout.pose, rollout.anchor, remaining))
        action = self.decode_action(torch.cat(inputs, dim=1))  # (E, 2)
        return MAX_ACTION * torch.tanh(action / MAX_ACTION)

    def _remember(
        self, rollout: Rollout, context: Float[Tensor, "E C"], action: Float[Tensor, "E 2"]
    ) -> Rollout:
        """Update the hidden states by actions."""
        seen = torch.cat([rollout.features, action, context[:, -ATTRIBUTES:]], dim=1)
        updated = self.update_hidden(seen, rollout.hidden)
        hidden = torch.where(rollout.moving, updated, rollout.hidden)
        return replace(rollout, hidden=hidden)

    def _move(self, rollout: Rollout, action: Float[Tensor, "E 2"]) -> Rollout:
        """Move the controlled agents that are there; those that enter do so as recorded."""
        batch, controlled = rollout.batch, rollout.batch.controlled
        row = controlled.segment, controlled.agent
        given = rollout.pose, self.scale_action(action), batch.sizes[:, 0], batch.segments.dt
        recorded = batch.segments.states[:, :, rollout.index + 1]
        after = torch.where(rollout.moving, self.motion.step(*given), recorded[row])  # (E, 4)
        return replace(rollout, index=rollout.index + 1, states=recorded.index_put(row, after))

    def _train_anchors(
        self, rollout: Rollout, generator: torch.Generator, top_k: int
    ) -> tuple[Float[Tensor, "E P 2"], Float[Tensor, ""]]:
        """The true points, which decoders follow in training, and the proposals' loss."""
        truth, history = rollout.batch.truth, rollout.batch.history
        past = truth[:, :history, :2]
        noise = torch.randn(past.shape, generator=generator, device=past.device)
        noisy = past + HISTORY_NOISE_M * noise
        anchors, logits = self.anchors(rollout.pose, noisy, rollout.features)
        target = truth[:, [history - 1 + step for step in self.anchors.steps], :2]
        return target, compute_anchor_loss(anchors, logits, target, top_k)

    def _update_features(
        self,
        batch: Batch,
        states: Float[Tensor, "B N 4"],
        step: int,
        features: Float[Tensor, "E F"],
    ) -> Float[Tensor, "E F"]:
        """Encode views at each `view_stride`-th step and of who enters; else keep features."""
        config, due = self.config, (step - batch.history + 1) % self.config.view_stride == 0
        now = batch.present[:, step] if due else batch.find_entering(step)
        if not config.use_observations or not now.any():
            return features
        shown = Controlled(batch.controlled.segment[now], batch.controlled.agent[now])
        split = split_views(config.view, batch.segments, shown, states, step)
        parts = [self._render_and_encode(batch, states, step, some) for some in split]
        return features.index_put((now.nonzero()[:, 0],), torch.cat(parts).to(features))

    def _render_and_encode(
        self, batch: Batch, states: Float[Tensor, "B N 4"], step: int, controlled: Controlled
    ) -> Float[Tensor, "e F"]:
        """Render and encode the views of some of the controlled agents."""
        views = render_observation(
            self.config.view, batch.ground, batch.segments, controlled, states, step
        )  # (e, 7, H, W)
        if self.config.surface_contrast:
            views = torch.cat([views, compute_surface_contrast(views)], dim=1)
        device = views.device.type
        with torch.autocast(device, dtype=torch.bfloat16, enabled=device == "cuda"):
            return self.encoder((views - 0.5).to(memory_format=torch.channels_last))
