"""Networks that are trained on one place in seconds: from an agent's own past to its futures.

The plain network knows an agent's past and nothing else, neither map nor others: it is a baseline
(`sample`). A model that was trained on a place holds one, whose proposals are taken beside samples
for agents where it knows traffic.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from geoaim.prediction.config import Config
from geoaim.prediction.networks import build_mlp
from geoaim.prediction.segments import Segments, mark_entries
from geoaim.rendering.ground import Ground
from geoaim.simulation.kinematics import agent_from_world, world_from_agent, wrap_angle

PROPOSALS = 6
WIDTH = 128
KNOT_S = 0.5  # between velocities, which are interpolated
SPEED_SCALE = 10.0  # m/s
STEPS, BATCH_SIZE, LEARNING_RATE = 400, 128, 2e-3
PAST_NOISE_M = 0.03  # on observed positions in training
# in the loss, of the mean error over all proposals, so that none stays unused, and of the error of
# the first one, which is thus the best single guess
EVEN_SHARE, FIRST_SHARE = 0.05, 1.0
CELL_M = 10.0  # side of the cells of a place in which a network knows traffic
MIN_SPEED_MPS = 0.5  # slower agents keep their heading
STANDING_MPS = 0.3  # agents that never were faster in the observed steps stand


class PlainNetwork(nn.Module):
    """Proposes futures of agents from their own past.

    Args:
        config: motion, dt and kind of the agents.
        history: observed steps that it reads; missing ones are continued backwards.
        horizon: steps that it proposes.
        cells: (M, 2) numbers of the cells of a place in which it knows traffic; None: everywhere.
    """

    cells: Tensor | None

    def __init__(
        self,
        config: Config,
        history: int,
        horizon: int,
        *,
        cells: Float[Tensor, "M 2"] | None = None,
    ) -> None:
        super().__init__()
        self.dt, self.history, self.horizon = config.dt, history, horizon
        self.knots = 1 + max(1, round(horizon * config.dt / KNOT_S))
        self.register_buffer("cells", cells)
        inputs = 5 * history + 3
        self.propose = build_mlp(inputs, WIDTH, PROPOSALS * self.knots * 2)
        self.score = build_mlp(inputs, WIDTH // 2, PROPOSALS)

    def forward(
        self, past: Float[Tensor, "E t 4"], there: Bool[Tensor, "E t"], sizes: Float[Tensor, "E 2"]
    ) -> tuple[Float[Tensor, "E P T 4"], Float[Tensor, "E P"]]:
        """Propose futures.

        Args:
            past: observed states of E agents, the last one at the end.
            there: at which of these steps they are there.
            sizes: their lengths and widths, metres.

        Returns:
            States at the T steps after the last observed one, by P proposals; and a logit of each.
        """
        now, inputs = past[:, -1], self._encode(past, there, sizes)
        knots = self.propose(inputs).view(len(past) * PROPOSALS, self.knots, 2).transpose(1, 2)
        change = F.interpolate(knots, self.horizon, mode="linear", align_corners=True)
        velocity = change.view(len(past), PROPOSALS, 2, self.horizon).transpose(2, 3)
        ahead = torch.zeros_like(velocity)
        ahead[..., 0] = now[:, 3, None, None]
        velocity = velocity + ahead  # in the agent's frame
        position = world_from_agent(now[:, None, None], velocity.cumsum(2) * self.dt)
        motion = self._find_headings(velocity, now)
        return torch.cat([position, motion], dim=-1), self.score(inputs)

    def knows(self, now: Float[Tensor, "E 4"]) -> Bool[Tensor, "E"]:
        """Mark agents that are where the network knows traffic."""
        if self.cells is None:
            return torch.ones_like(now[:, 0], dtype=torch.bool)
        cell = torch.floor(now[:, None, :2] / CELL_M)
        return (cell == self.cells).all(dim=2).any(dim=1)

    def _find_headings(
        self, velocity: Float[Tensor, "E P T 2"], now: Float[Tensor, "E 4"]
    ) -> Float[Tensor, "E P T 2"]:
        """Headings and speeds of motions; who is slow keeps the heading, who reverses turns not."""
        forward = torch.where(now[:, 3] < 0, -1.0, 1.0)[:, None, None]
        speed = velocity.norm(dim=-1) * forward
        turn = torch.atan2(velocity[..., 1] * forward, velocity[..., 0] * forward)
        turns, last = [], torch.zeros_like(turn[..., 0])
        for step in range(self.horizon):
            last = torch.where(speed[..., step].abs() > MIN_SPEED_MPS, turn[..., step], last)
            turns.append(last)
        heading = wrap_angle(now[:, 2, None, None] + torch.stack(turns, dim=-1))
        return torch.stack([heading, speed], dim=-1)

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
    def plan(
        self, segments: Segments, history: int
    ) -> tuple[Float[Tensor, "B N P T 4"], Float[Tensor, "B N P"]]:
        """Propose futures of the controlled agents that are there: the best single guess first.

        Args:
            segments: segments.
            history: observed steps.

        Returns:
            States, and the probability of each proposal; 0 of agents that stand, or are where the
            network does not know traffic.
        """
        past, there = segments.states[:, :, :history], segments.present[:, :, :history]
        drives = (there & (past[..., 3].abs() > STANDING_MPS)).any(dim=2)
        row, agent = (segments.controlled & there[:, :, -1] & drives).nonzero().unbind(1)
        known = self.knows(past[row, agent, -1])
        row, agent = row[known], agent[known]
        probabilities = past.new_zeros(*drives.shape, PROPOSALS)
        plans = past.new_zeros(*probabilities.shape, self.horizon, 4)
        if len(row):
            given = past[row, agent], there[row, agent], segments.sizes[row, agent]
            plans[row, agent], logits = self(*given)
            probabilities[row, agent] = logits.softmax(dim=1)
        return plans, probabilities

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
        """Predict as a `Predictor`; who enters later or stands goes straight on.

        Samples are joint futures of agents that do not see each other, so that each agent's
        proposals are shuffled.
        """
        plans, probabilities = self.plan(segments, history)
        straight = _go_straight(segments, history)
        row, agent = (probabilities > 0).any(dim=2).nonzero().unbind(1)
        path = straight[:, None].repeat(1, samples, 1, 1, 1)
        drawn = torch.rand(len(row), samples, generator=generator, device=row.device)
        chosen = drawn.argsort(dim=1) % max(1, min(samples, PROPOSALS))  # (E, K)
        futures = plans[row[:, None], agent[:, None], chosen]  # (E, K, T, 4)
        futures = extend(futures, segments.steps - history, self.dt)
        path[row[:, None], torch.arange(samples), agent[:, None], history:] = futures
        return path


def train_plain(
    segments: Segments, config: Config, *, history: int, place: bool = False, steps: int = STEPS
) -> PlainNetwork:
    """Train a network on segments of single agents, in seconds on a CPU.

    In each case the best of its proposals is trained, the first one, and a little all of them.

    Args:
        segments: segments with one controlled agent each, which is there at all steps.
        config: motion and dt of the agents.
        history: observed steps.
        place: whether it is for the place of the segments alone.
        steps: steps of the optimiser.

    Returns:
        The network, in evaluation mode.
    """
    agent = segments.controlled.float().argmax(dim=1)
    rows = torch.arange(len(segments), device=agent.device)
    states, sizes = segments.states[rows, agent], segments.sizes[rows, agent]
    places = torch.floor(states[..., :2].flatten(0, 1) / CELL_M)
    cells = torch.unique(places, dim=0) if place else None
    generator = torch.Generator().manual_seed(0)
    with torch.random.fork_rng(devices=[]), torch.enable_grad():
        torch.manual_seed(0)
        network = PlainNetwork(config, history, segments.steps - history, cells=cells)
        network.to(states.device)
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
            truth = states[index, history:]
            loss = _compute_loss(network(past, there.to(past.device), sizes[index]), truth)
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            schedule.step()
    return network.eval()


def _compute_loss(
    proposed: tuple[Float[Tensor, "E P T 4"], Float[Tensor, "E P"]], truth: Float[Tensor, "E T 4"]
) -> Float[Tensor, ""]:
    """Distances of the best, the first and all proposals, metres, and the logits' entropy."""
    states, logits = proposed
    offset = states[..., :2] - truth[:, None, :, :2]
    errors = (offset.square().sum(dim=-1) + 1e-4).sqrt().mean(dim=2)  # (E, P)
    best = errors.min(dim=1)
    even = EVEN_SHARE * errors.mean() + FIRST_SHARE * errors[:, 0].mean()
    return best.values.mean() + even + F.cross_entropy(logits, best.indices) / 10


def extend(futures: Float[Tensor, "*_ t 4"], steps: int, dt: float) -> Float[Tensor, "*_ T 4"]:
    """Cut futures, or go straight on beyond their ends."""
    more = steps - futures.shape[-2]
    if more <= 0:
        return futures[..., :steps, :]
    last = futures[..., -1:, :]
    way = last[..., 3] * dt * torch.arange(1, more + 1, device=last.device)
    x, y = last[..., 0] + way * last[..., 2].cos(), last[..., 1] + way * last[..., 2].sin()
    rest = torch.stack([x, y, last[..., 2].expand_as(x), last[..., 3].expand_as(x)], dim=-1)
    return torch.cat([futures, rest], dim=-2)


def _go_straight(segments: Segments, history: int) -> Float[Tensor, "B N T 4"]:
    """Let controlled agents go straight on from the last observed step, or where they enter."""
    starts = mark_entries(segments.present, history)  # (B, N, t)
    path = list(segments.states.unbind(2))
    for step in range(history, segments.steps):
        onward = extend(path[step - 1][..., None, :], 2, segments.dt)[..., 1, :]
        recorded = starts[:, :, step - history] | ~segments.controlled
        path[step] = torch.where(recorded[..., None], segments.states[:, :, step], onward)
    return torch.stack(path, dim=2)
