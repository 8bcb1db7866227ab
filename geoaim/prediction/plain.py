"""The plain network: what an agent's own past tells of its future, without map and others.

It proposes controls from the observed states of one agent, by which its motion model moves it. It
is trained in seconds on the recordings of a place, and stands there as a baseline (`sample`). A
model that was trained on a place holds it, and some of its samples follow its proposals.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from geoaim.prediction.braking import compute_curvature
from geoaim.prediction.config import Config
from geoaim.prediction.networks import build_mlp
from geoaim.prediction.rollouts import MAX_ACTION
from geoaim.prediction.segments import Segments
from geoaim.rendering.ground import Ground
from geoaim.simulation.kinematics import MOTION_MODELS, agent_from_world, wrap_angle

PROPOSALS = 6
WIDTH = 128
KNOT_S = 0.5  # between controls, which are interpolated
POSITION_SCALE_M, SPEED_SCALE = 10.0, 10.0
STEPS, BATCH_SIZE, LEARNING_RATE = 400, 128, 2e-3
PAST_NOISE_M = 0.03  # on observed positions in training
EVEN_SHARE = 0.05  # of the mean error over all proposals in the loss, so that none stays unused


class PlainNetwork(nn.Module):
    """Proposes futures of agents from their own past.

    Args:
        config: motion, dt and kind of the agents.
        history: observed steps that it reads; missing ones are continued backwards.
        horizon: steps that it proposes.
    """

    def __init__(self, config: Config, history: int, horizon: int) -> None:
        super().__init__()
        self.dt, self.bends = config.dt, config.motion == "bicycle"
        self.scale = MOTION_MODELS[config.motion].scale
        self.history, self.horizon = history, horizon
        self.knots = max(2, round(horizon * config.dt / KNOT_S))
        self.propose = build_mlp(5 * history + 3, WIDTH, PROPOSALS * self.knots * 2)
        self.score = build_mlp(5 * history + 3, WIDTH // 2, PROPOSALS)

    def forward(
        self, past: Float[Tensor, "E t 4"], there: Bool[Tensor, "E t"], sizes: Float[Tensor, "E 2"]
    ) -> tuple[Float[Tensor, "E P T 4"], Float[Tensor, "E P T 2"], Float[Tensor, "E P"]]:
        """Propose futures.

        Args:
            past: observed states of E agents, the last one at the end.
            there: at which of these steps they are there.
            sizes: their lengths and widths, metres.

        Returns:
            States at the T steps after the last observed one, by P proposals; the actions that lead
            there, not normalised; and a logit of each proposal.
        """
        inputs = self._encode(past, there, sizes)
        knots = self.propose(inputs).view(len(past), PROPOSALS, self.knots, 2).transpose(2, 3)
        actions = F.interpolate(
            knots.flatten(0, 1), self.horizon, mode="linear", align_corners=True
        ).view(len(past), PROPOSALS, 2, self.horizon)
        actions = (MAX_ACTION * torch.tanh(actions / MAX_ACTION)).transpose(2, 3)
        actions = actions * actions.new_tensor(self.scale)
        return self._integrate(past[:, -1], actions, sizes), actions, self.score(inputs)

    def _integrate(
        self, start: Float[Tensor, "E 4"], actions: Float[Tensor, "E P T 2"], sizes: Tensor
    ) -> Float[Tensor, "E P T 4"]:
        """Take all steps of the bicycle or the unicycle at once: sums of arcs, as of `motion`."""
        speed = start[:, None, None, 3] + actions[..., 0].cumsum(2) * self.dt
        before = torch.cat([start[:, None, None, 3].expand_as(speed[..., :1]), speed[..., :-1]], 2)
        distance = (before + speed) / 2 * self.dt
        if self.bends:
            slip = torch.atan(torch.tan(actions[..., 1]) / 2)
            turn = compute_curvature(actions[..., 1], sizes[:, None, None, 0]) * distance
        else:
            slip, turn = torch.zeros_like(speed), actions[..., 1] * self.dt
        heading = start[:, None, None, 2] + turn.cumsum(2)
        course = heading - turn / 2 + slip
        chord = distance * torch.sinc(turn / (2 * torch.pi))
        x = start[:, None, None, 0] + (chord * course.cos()).cumsum(2)
        y = start[:, None, None, 1] + (chord * course.sin()).cumsum(2)
        return torch.stack([x, y, wrap_angle(heading), speed], dim=-1)

    def _encode(self, past: Tensor, there: Tensor, sizes: Tensor) -> Float[Tensor, "E _"]:
        """Observed states in the frame of the last one; missing ones are continued backwards."""
        past, there = past[:, -self.history :], there[:, -self.history :]
        missing = self.history - past.shape[1]
        past = F.pad(past, (0, 0, missing, 0))
        there = F.pad(there, (missing, 0))
        now = past[:, -1]
        local = agent_from_world(now[:, None], past[..., :2])
        since = torch.arange(1 - self.history, 1, device=past.device) * self.dt
        straight = torch.stack([now[:, 3:] * since, torch.zeros_like(now[:, 3:] * since)], dim=2)
        position = torch.where(there[..., None], local, straight)
        turn = torch.where(there, wrap_angle(past[..., 2] - now[:, None, 2]), 0.0)
        speed = torch.where(there, past[..., 3], now[:, 3:])
        columns = [position - straight, turn[..., None], speed[..., None] - now[:, None, 3:]]
        numbers = torch.cat([*columns, there[..., None].to(past)], dim=2).flatten(1)
        return torch.cat([numbers, now[:, 3:] / SPEED_SCALE, sizes / 5], dim=1)

    @torch.no_grad()
    def sample(
        self,
        segments: Segments,
        ground: Ground,
        *,
        history: int,
        samples: int,
        generator: torch.Generator,
    ) -> Float[Tensor, "B K N T 4"]:
        """Predict as a `Predictor`: each agent's likeliest proposals, in an order of its own.

        Samples are joint futures of agents that do not see each other, so that each agent's
        proposals are shuffled; those who enter later go straight on.
        """
        path = segments.states[:, None].repeat(1, samples, 1, 1, 1)
        row, agent = (segments.controlled & segments.present[:, :, history - 1]).nonzero().unbind(1)
        steps = segments.steps - history
        if len(row):
            past = segments.states[row, agent, :history], segments.present[row, agent, :history]
            states, _, logits = self(*past, segments.sizes[row, agent])
            order = logits.argsort(dim=1, descending=True)[:, : max(1, min(samples, PROPOSALS))]
            shuffled = torch.rand(len(row), samples, generator=generator, device=row.device)
            chosen = order.gather(1, shuffled.argsort(dim=1) % order.shape[1])  # (E, K)
            futures = states[torch.arange(len(row))[:, None], chosen]  # (E, K, T, 4)
            futures = _extend(futures, steps, self.dt)
            path[row[:, None], torch.arange(samples), agent[:, None], history:] = futures
        entering = segments.controlled & ~segments.present[:, :, history - 1]
        if entering.any():
            _go_straight(path, segments, entering, history)
        return path


def train_plain(
    segments: Segments, config: Config, *, history: int, steps: int = STEPS, seed: int = 0
) -> PlainNetwork:
    """Train a plain network on segments of single agents, in seconds on a CPU.

    Only the best of its proposals is trained in each case, and a little all of them.

    Args:
        segments: segments with one controlled agent each, which is there at all steps.
        config: motion and dt of the agents.
        history: observed steps.
        steps: steps of the optimiser.
        seed: seed of weights and batches.

    Returns:
        The network, in evaluation mode.
    """
    agent = segments.controlled.float().argmax(dim=1)
    rows = torch.arange(len(segments), device=agent.device)
    states, sizes = segments.states[rows, agent], segments.sizes[rows, agent]
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]), torch.enable_grad():
        torch.manual_seed(seed)
        network = PlainNetwork(config, history, segments.steps - history).to(states.device)
        optimiser = torch.optim.AdamW(network.parameters(), LEARNING_RATE, weight_decay=0.01)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, LEARNING_RATE, total_steps=steps + 1
        )
        for _ in range(steps):
            index = torch.randint(len(states), (BATCH_SIZE,), generator=generator).to(rows.device)
            seen = torch.rand(BATCH_SIZE, generator=generator) * history * 1.5
            past = states[index, :history].clone()
            noise = torch.randn((*past.shape[:2], 2), generator=generator).to(past)
            past[:, :-1, :2] += PAST_NOISE_M * noise[:, :-1]
            there = torch.arange(history) >= (history - 1 - seen.long()[:, None])
            loss = _compute_loss(
                network, past, there.to(past.device), sizes[index], states[index, history:]
            )
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            schedule.step()
    return network.eval()


def _compute_loss(
    network: PlainNetwork, past: Tensor, there: Tensor, sizes: Tensor, truth: Tensor
) -> Float[Tensor, ""]:
    """Mean distance of the best proposal, metres, and the cross entropy of the logits."""
    states, _, logits = network(past, there, sizes)
    offset = states[..., :2] - truth[:, None, :, :2]
    errors = (offset.square().sum(dim=-1) + 1e-4).sqrt().mean(dim=2)  # (E, P)
    best = errors.min(dim=1)
    even = EVEN_SHARE * errors.mean()
    return best.values.mean() + even + F.cross_entropy(logits, best.indices) / 10


def _extend(futures: Float[Tensor, "E K t 4"], steps: int, dt: float) -> Float[Tensor, "E K T 4"]:
    """Cut futures, or go straight on beyond their ends."""
    more = steps - futures.shape[2]
    if more <= 0:
        return futures[:, :, :steps]
    last = futures[:, :, -1:]
    way = last[..., 3] * dt * torch.arange(1, more + 1, device=last.device)
    x, y = last[..., 0] + way * last[..., 2].cos(), last[..., 1] + way * last[..., 2].sin()
    rest = torch.stack([x, y, last[..., 2].expand_as(x), last[..., 3].expand_as(x)], dim=-1)
    return torch.cat([futures, rest], dim=2)


def _go_straight(
    path: Float[Tensor, "B K N T 4"], segments: Segments, entering: Bool[Tensor, "B N"], start: int
) -> None:
    """Let agents go straight on from where they enter, in place."""
    for row, agent in entering.nonzero().tolist():
        there = segments.present[row, agent, start:].nonzero()[:, 0]
        if len(there):
            first = start + int(there[0])
            state = segments.states[row, agent, first].expand(1, 1, 1, 4)
            future = _extend(state, segments.steps - first, segments.dt)
            path[row, :, agent, first:] = future[0]
