"""Trajectory proposals: several coarse trajectories at once, of which each sample follows one.

Beyond the paper. Only the best proposals of each agent are trained, so that they spread.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from geoaim.prediction.config import Config
from geoaim.prediction.networks import build_mlp
from geoaim.simulation.kinematics import agent_from_world, world_from_agent

ANCHOR_SCALE_M = 10.0  # typical distance to a proposal's points
HISTORY_NOISE_M = 0.04  # noise on observed positions in training, against overfitting to them


class AnchorHead(nn.Module):
    """Proposes trajectories from observed positions and a view, with a logit for each.

    It reads the observed positions rather than the GRU's hidden state, which loses detail. The
    speed is taken from them too, so that it carries the same noise in training.

    Args:
        config: the model's configuration; it observes two steps or more.

    Raises:
        ValueError: fewer than two steps are observed.
    """

    def __init__(self, config: Config) -> None:
        super().__init__()
        history, points, width = config.history, config.anchor_points, config.hidden_size
        if history < 2:
            raise ValueError(f"anchors need two or more observed steps; history is {history}")
        self.steps = [round(config.horizon * (k + 1) / points) for k in range(points)]
        inputs, count = config.feature_size + 2 * history, config.num_anchors
        self.propose = build_mlp(inputs, 2 * width, count * 2 * points)
        self.score = build_mlp(inputs, width, count)

    def forward(
        self,
        pose: Float[Tensor, "E 4"],
        past: Float[Tensor, "E t 2"],
        features: Float[Tensor, "E F"],
    ) -> tuple[Float[Tensor, "E A P 2"], Float[Tensor, "E A"]]:
        """Propose trajectories as offsets from constant velocity.

        Args:
            pose: x, y, heading, speed of E agents at the last observed step.
            past: observed positions in the world, metres.
            features: encoded views.

        Returns:
            P points of A proposals in the world, metres, and the logit of each proposal.
        """
        local = agent_from_world(pose[:, None], past)  # (E, t, 2)
        inputs = torch.cat([features, local.flatten(1)], dim=1)  # (E, F + 2 t)
        offsets = ANCHOR_SCALE_M * self.propose(inputs).view(len(pose), -1, len(self.steps), 2)
        velocity = local[:, -1:] - local[:, -2:-1]  # (E, 1, 2) metres a step
        straight = velocity * offsets.new_tensor(self.steps)[:, None]  # (E, P, 2)
        anchors = world_from_agent(pose[:, None, None], offsets + straight[:, None])
        return anchors, self.score(inputs)


def compute_anchor_loss(
    anchors: Float[Tensor, "E A P 2"],
    logits: Float[Tensor, "E A"],
    target: Float[Tensor, "E P 2"],
    top_k: int,
) -> Float[Tensor, ""]:
    """Compute the loss of trajectory proposals against the ground truth.

    Only the `top_k` best proposals of each agent are trained: all at first and one in the end, so
    that no proposal stays unused (evolving winner-takes-all, Makansi et al. 2019). The logits are
    trained to tell the best one.

    Args:
        anchors: points of the proposals, metres.
        logits: logits of the proposals.
        target: the ground truth at the same steps, metres.
        top_k: proposals of each agent that are trained.

    Returns:
        The mean distance over all points, plus half of the distance at the last point (metres),
        plus a tenth of the cross entropy of the logits.
    """
    distances = (anchors - target[:, None]).norm(dim=-1)  # (E, A, P)
    mean, best = distances.mean(dim=2).topk(top_k, dim=1, largest=False)
    final = distances[..., -1].topk(top_k, dim=1, largest=False).values
    cross_entropy = nn.functional.cross_entropy(logits, best[:, 0])
    return mean.mean() + final.mean() / 2 + cross_entropy / 10


def select_anchor(
    anchors: Float[Tensor, "E A P 2"], logits: Float[Tensor, "E A"], rank: Int[Tensor, "E"]
) -> Float[Tensor, "E P 2"]:
    """Select the proposal that a sample follows.

    Args:
        anchors: points of the proposals.
        logits: logits of the proposals.
        rank: 0 for the likeliest proposal; ranks beyond the last one start over.

    Returns:
        The points of the proposal of each agent.
    """
    order = logits.argsort(dim=1, descending=True)
    rows = torch.arange(len(rank), device=rank.device)
    return anchors[rows, order[rows, rank % anchors.shape[1]]]
