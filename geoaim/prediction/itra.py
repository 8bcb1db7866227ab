"""ITRA on image maps: a conditional variational recurrent neural network (CVRNN).

Ścibior et al. 2021, on the maps of Liu et al. 2023. At each step t an observation b_t is rendered
around each controlled agent, a latent z_t is drawn, an action a_t is decoded, the agent moves by
its kinematic model f_kin, and the hidden state h_t of a GRU is updated:

    z_t ~ N(0, I)        a_t = f_theta(b_t, z_t, h_{t-1})        s_{t+1} ~ N(f_kin(s_t, a_t), sigma)
    h_t = f_psi(h_{t-1}, b_t, a_t)

In training z_t comes from the posterior q_phi(z_t | b_t, a_t, h_{t-1}), where a_t is the
ground-truth action, and the evidence lower bound is maximized through kinematics and renderer.
All agents that are not controlled replay their ground truth.

Beyond the paper, a model may have trajectory proposals (`anchors`): at the last observed step it
proposes `num_anchors` of them, and each sample follows one, as a further input of f_theta.

Shapes: B segments, K samples, N agents, T steps, E controlled agents of all segments, F features,
H hidden state, Z latent, A proposals, P points of a proposal.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from geoaim.prediction.anchors import (
    ANCHOR_SCALE_M,
    HISTORY_NOISE_M,
    AnchorHead,
    compute_anchor_loss,
    select_anchor,
)
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
from geoaim.prediction.segments import Segments, repeat
from geoaim.simulation.ground import Ground
from geoaim.simulation.kinematics import MOTION_MODELS, agent_from_world, wrap_angle
from geoaim.simulation.prefiltering import prefilter_ground

MAX_ACTION = 4.0  # normalised; larger ground-truth actions are noise of headings at standstill
SPEED_SCALE_S = 0.5  # an error of 1 m/s counts as this many metres in the likelihood
ATTRIBUTES = 3  # speed, length and width
DT_TOLERANCE_S = 1e-3

DrawLatent = Callable[[Float[Tensor, "E C"], int], Float[Tensor, "E Z"]]  # takes context and step
Recurrent = tuple[Float[Tensor, "E F"], Float[Tensor, "E H"]]  # encoded views and hidden states
ChooseAnchor = Callable[[Float[Tensor, "E 4"], Float[Tensor, "E F"]], Float[Tensor, "E P 2"]]


@dataclass(frozen=True, eq=False)
class Losses:
    """Means over controlled agents and predicted steps."""

    # negative log-likelihood of the ground-truth states, without its constant
    nll: Float[Tensor, ""]
    kl: Float[Tensor, ""]  # Kullback-Leibler divergence of the posterior from the prior, nats
    anchor: Float[Tensor, ""]  # `compute_anchor_loss` of the proposals, metres; 0 without proposals


@dataclass(frozen=True, eq=False)
class _Batch:
    """Segments with the index of their controlled agents."""

    segments: Segments  # states of all agents
    ground: Ground  # the map
    controlled: Controlled  # index of the E controlled agents
    history: int  # observed steps

    @property
    def truth(self) -> Float[Tensor, "E T 4"]:
        """Ground-truth states of the controlled agents."""
        return self.segments.states[self.controlled.segment, :, self.controlled.agent]

    @property
    def sizes(self) -> Float[Tensor, "E 2"]:
        """Lengths and widths of the controlled agents."""
        return self.segments.sizes[self.controlled.segment, self.controlled.agent]

    @property
    def present(self) -> Bool[Tensor, "E T"]:
        """Presence of the controlled agents."""
        return self.segments.present[self.controlled.segment, :, self.controlled.agent]


class ITRA(nn.Module):
    """The model. `forward` computes the losses of segments, `sample` draws futures.

    Args:
        config: its hyperparameters.
    """

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.config = config
        self.motion = MOTION_MODELS[config.motion]
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
        batch = self._index(segments, ground, history)
        truth = batch.truth  # (E, T, 4)
        actions = self._normalise_actions(batch)  # (E, T - 1, 2)
        kl, anchor_loss = [], truth.new_zeros(())

        def draw_latent(context: Tensor, step: int) -> Tensor:
            inputs = torch.cat([context, actions[:, step]], dim=1)  # (E, C + 2)
            mean, log_scale = self.posterior(inputs).chunk(2, 1)  # (E, Z) each
            log_scale = log_scale.clamp(-5, 3)
            scale = log_scale.exp()
            kl.append((0.5 * (mean**2 + scale**2 - 1) - log_scale).sum(dim=1))
            return mean + scale * torch.randn(mean.shape, generator=generator, device=mean.device)

        def choose_anchor(pose: Tensor, features: Tensor) -> Tensor:
            nonlocal anchor_loss
            past = truth[:, :history, :2]
            noise = torch.randn(past.shape, generator=generator, device=past.device)
            anchors, logits = self.anchors(pose, past + HISTORY_NOISE_M * noise, features)
            target = truth[:, [history - 1 + step for step in self.anchors.steps], :2]
            anchor_loss = compute_anchor_loss(anchors, logits, target, top_k)
            return target

        recurrent = self._encode_history(batch, actions)
        states = self._roll_out(batch, recurrent, draw_latent, choose_anchor)  # (B, T, N, 4)
        predicted = states[batch.controlled.segment, history:, batch.controlled.agent]
        scales = truth.new_tensor([1.0, 1.0, self.config.heading_scale, SPEED_SCALE_S])
        error = _subtract(predicted, truth[:, history:]) * (scales / self.config.sigma)
        nll = 0.5 * error.square().sum(dim=2).mean()
        return Losses(nll, torch.stack(kl, dim=1).mean(), anchor_loss)

    @torch.no_grad()
    def sample(
        self,
        segments: Segments,
        ground: Ground,
        *,
        history: int,
        samples: int,
        generator: torch.Generator,
        latent_scale: float = 1.0,
    ) -> Float[Tensor, "B K T N 4"]:
        """Sample joint futures of all controlled agents; all others replay.

        Args:
            segments: segments, whose first steps are observed; later steps of controlled agents are
                ignored.
            ground: the map. It is prefiltered for the model's views here unless that was done
                before (`prefilter_ground`), which saves time over many calls.
            history: observed steps.
            samples: K futures to draw.
            generator: source of the noise, on the segments' device.
            latent_scale: factor on the prior's standard deviation.

        Returns:
            States x, y (m), heading (rad), speed (m/s) of all agents at all steps, the observed
            ones included.

        Raises:
            ValueError: the segments do not fit the model.
        """
        ground = prefilter_ground(ground, self.config.resolution)
        one = self._index(segments, ground, history)
        features, hidden = self._encode_history(one, self._normalise_actions(one))
        number = segments.controlled.long()  # (B, N) row of each controlled agent
        number[one.controlled.segment, one.controlled.agent] = torch.arange(
            len(one.truth), device=number.device
        )
        repeated = repeat(segments, samples)
        batch = _Batch(repeated, ground, index_controlled(repeated), history)
        segment = batch.controlled.segment
        row = number[segment // samples, batch.controlled.agent]  # (E K,)
        recurrent = features[row], hidden[row]

        def draw_latent(context: Tensor, step: int) -> Tensor:
            shape = (len(context), self.config.latent_size)
            return latent_scale * torch.randn(shape, generator=generator, device=context.device)

        def choose_anchor(pose: Tensor, features: Tensor) -> Tensor:
            anchors, logits = self.anchors(pose, batch.truth[:, :history, :2], features)
            return select_anchor(anchors, logits, segment % samples)

        states = self._roll_out(batch, recurrent, draw_latent, choose_anchor)  # (B K, T, N, 4)
        return states.view(len(segments), samples, *states.shape[1:])

    def _encode_history(self, batch: _Batch, actions: Float[Tensor, "E t 2"]) -> Recurrent:
        """Replay all observed steps but the last one, and update hidden states on the way."""
        controlled, sizes = batch.controlled, batch.sizes
        features = sizes.new_zeros(len(sizes), self.config.feature_size)
        hidden = sizes.new_zeros(len(sizes), self.config.hidden_size)
        for step in range(batch.history - 1):
            states = batch.segments.states[:, step]  # (B, N, 4)
            features = self._encode_view(batch, states, step, features)  # (E, F)
            attributes = _normalise_attributes(states[controlled.segment, controlled.agent], sizes)
            inputs = torch.cat([features, actions[:, step], attributes], dim=1)  # (E, F + 2 + 3)
            updated = self.update_hidden(inputs, hidden)  # (E, H)
            # the hidden state of an agent that enters later stays zero until then
            present = batch.present[:, step : step + 2].all(dim=1, keepdim=True)
            hidden = torch.where(present, updated, hidden)
        return features, hidden

    def _roll_out(
        self,
        batch: _Batch,
        recurrent: Recurrent,
        draw_latent: DrawLatent,
        choose_anchor: ChooseAnchor,
    ) -> Float[Tensor, "B T N 4"]:
        """Roll controlled agents out from the last observed step; all others replay."""
        segments, controlled, sizes = batch.segments, batch.controlled, batch.sizes
        first, total = batch.history - 1, segments.states.shape[1]
        (features, hidden), anchor = recurrent, None
        states = segments.states[:, first]  # (B, N, 4)
        path = list(segments.states[:, : batch.history].unbind(dim=1))
        for step in range(first, total - 1):
            pose = states[controlled.segment, controlled.agent]  # (E, 4)
            attributes = _normalise_attributes(pose, sizes)  # (E, 3)
            features = self._encode_view(batch, states, step, features)  # (E, F)
            context = torch.cat([features, hidden, attributes], dim=1)  # (E, F + H + 3)
            if self.config.num_anchors and step == first:
                anchor = choose_anchor(pose, features)  # (E, P, 2)
            inputs = [context, draw_latent(context, step)]
            if anchor is not None:
                inputs.append(_encode_anchor(pose, anchor, (total - 1 - step) / total))
            action = self.decode_action(torch.cat(inputs, dim=1))  # (E, 2)
            action = MAX_ACTION * torch.tanh(action / MAX_ACTION)
            action_in_units = action * action.new_tensor(self.motion.scale)
            after = self.motion.step(pose, action_in_units, sizes[:, 0], segments.dt)  # (E, 4)
            hidden = self.update_hidden(torch.cat([features, action, attributes], dim=1), hidden)
            states = segments.states[:, step + 1].index_put(
                (controlled.segment, controlled.agent), after
            )
            path.append(states)
        return torch.stack(path, dim=1)

    def _encode_view(
        self,
        batch: _Batch,
        states: Float[Tensor, "B N 4"],
        step: int,
        features: Float[Tensor, "E F"],
    ) -> Float[Tensor, "E F"]:
        """Encode views every `view_stride` steps; else, and for absent agents, reuse features."""
        config = self.config
        if not config.use_observations or (step - batch.history + 1) % config.view_stride:
            return features
        split = split_views(config.view, batch.segments, batch.controlled, states, step)
        parts = [self._encode(batch, states, step, some) for some in split]
        encoded = torch.cat(parts).to(features)
        return torch.where(batch.present[:, step, None], encoded, features)

    def _encode(
        self, batch: _Batch, states: Float[Tensor, "B N 4"], step: int, controlled: Controlled
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

    def _normalise_actions(self, batch: _Batch) -> Float[Tensor, "E t 2"]:
        """Compute the ground-truth actions of all steps, normalised."""
        before, after = batch.truth[:, :-1], batch.truth[:, 1:]
        actions = self.motion.inverse(before, after, batch.sizes[:, :1], batch.segments.dt)
        return (actions / actions.new_tensor(self.motion.scale)).clamp(-MAX_ACTION, MAX_ACTION)

    def _index(self, segments: Segments, ground: Ground, history: int) -> _Batch:
        """Index the controlled agents of segments, and check that they fit the model."""
        config, total = self.config, segments.states.shape[1]
        if abs(segments.dt - config.dt) > DT_TOLERANCE_S:
            raise ValueError(f"segments have a dt of {segments.dt:g} s, the model {config.dt:g} s")
        if not 1 <= history < total:
            raise ValueError(
                f"history is {history}, but the segments have {total} steps; give 1 to "
                f"{total - 1}, so that a step remains to predict"
            )
        if not segments.controlled.any():
            raise ValueError("no agent in these segments is controlled")
        batch = _Batch(segments, ground, index_controlled(segments), history)
        if config.num_anchors:
            if (history, total - history) != (config.history, config.horizon):
                raise ValueError(
                    f"history is {history} and the segments have {total} steps; the model's "
                    f"proposals need a history of {config.history} and "
                    f"{config.history + config.horizon} steps"
                )
            if not batch.present[:, :history].all():
                raise ValueError(
                    f"proposals need agents that are present in all {history} observed steps"
                )
        return batch


def _normalise_attributes(
    pose: Float[Tensor, "E 4"], sizes: Float[Tensor, "E 2"]
) -> Float[Tensor, "E 3"]:
    """Speed, length and width of agents, normalised."""
    return torch.cat([pose[:, 3:] / 10, sizes / 5], dim=1)


def _encode_anchor(
    pose: Float[Tensor, "E 4"], anchor: Float[Tensor, "E P 2"], remaining: float
) -> Float[Tensor, "E _"]:
    """A proposal in the agent's frame, normalised, and the share of steps that remain."""
    local = agent_from_world(pose[:, None], anchor) / ANCHOR_SCALE_M
    return torch.cat([local.flatten(1), torch.full_like(pose[:, :1], remaining)], dim=1)


def _subtract(states: Float[Tensor, "E t 4"], truth: Float[Tensor, "E t 4"]) -> Tensor:
    """Difference of states, headings wrapped to [-pi, pi)."""
    x, y, heading, speed = (states - truth).unbind(-1)
    return torch.stack([x, y, wrap_angle(heading), speed], dim=-1)
