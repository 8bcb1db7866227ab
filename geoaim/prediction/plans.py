"""Plans: points of the way ahead, several at once, of which each sample follows one.

Beyond the paper, for best-of-K measures: plans are taught by the best of them, so that they spread
over what may happen as such a measure rewards.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from geoaim.simulation.kinematics import agent_from_world, world_from_agent

REACH = 10.0  # m, usual way to a plan's points
JITTER = 0.04  # m of noise on known places while learning: plans are not to hang on single ones


class Planner(nn.Module):
    """Proposes plans from the known way and a view, and says how likely each is.

    It reads the known places themselves: a recurrent memory of them loses something. The speed too
    comes from them, so that while learning it has the same noise.

    Args:
        known: steps of the way that are known, two or more.
        ahead: steps after them that plans reach.
        modes: plans to propose.
        points: of a plan, evenly spaced in time, the last one at the end.
        features: width of what a view is encoded to.
        width: of the networks' layers.

    Raises:
        ValueError: fewer than two steps are known.
    """

    def __init__(
        self, known: int, ahead: int, modes: int, points: int, features: int, width: int
    ) -> None:
        super().__init__()
        if known < 2:
            raise ValueError(f"plans from {known} known steps; two or more tell where one goes")
        self.steps = [round(ahead * (k + 1) / points) for k in range(points)]
        self.propose = network(features + 2 * known, 2 * width, modes * 2 * points)
        self.weigh = network(features + 2 * known, width, modes)

    def forward(
        self,
        pose: Float[Tensor, "E 4"],
        past: Float[Tensor, "E k 2"],
        seen: Float[Tensor, "E F"],
    ) -> tuple[Float[Tensor, "E M P 2"], Float[Tensor, "E M"]]:
        """Plans in the world, as the last known step goes on and what is off it; logits of each."""
        behind = agent_from_world(pose[:, None], past)
        basis = torch.cat([seen, behind.flatten(1)], dim=1)
        points = REACH * self.propose(basis).view(len(pose), -1, len(self.steps), 2)
        straight = (behind[:, -1:] - behind[:, -2:-1]) * points.new_tensor(self.steps)[:, None]
        return world_from_agent(pose[:, None, None], points + straight[:, None]), self.weigh(basis)


def plan_loss(
    plans: Float[Tensor, "E M P 2"],
    logits: Float[Tensor, "E M"],
    way: Float[Tensor, "E P 2"],
    winners: int,
) -> Float[Tensor, ""]:
    """Metres that the best plans are off the true way, in all points and at its end.

    So many winners learn from each way: all at first and one in the end, so that no plan is left
    behind (Makansi et al. 2019). The logits learn which one was best.
    """
    off = (plans - way[:, None]).norm(dim=-1)
    whole, best = off.mean(dim=2).topk(winners, dim=1, largest=False)
    end = off[..., -1].topk(winners, dim=1, largest=False).values
    chance = nn.functional.cross_entropy(logits, best[:, 0])
    return whole.mean() + end.mean() / 2 + chance / 10


def nth_plan(
    plans: Float[Tensor, "E M P 2"], logits: Float[Tensor, "E M"], rank: Int[Tensor, "E"]
) -> Float[Tensor, "E P 2"]:
    """The plan that a sample follows: each of the likeliest ones once, then again."""
    order = logits.argsort(dim=1, descending=True)
    each = torch.arange(len(rank), device=rank.device)
    return plans[each, order[each, rank % plans.shape[1]]]


def network(inputs: int, width: int, outputs: int) -> nn.Sequential:
    """Two layers of a width."""
    return nn.Sequential(
        nn.Linear(inputs, width),
        nn.ReLU(),
        nn.Linear(width, width),
        nn.ReLU(),
        nn.Linear(width, outputs),
    )
