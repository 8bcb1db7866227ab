"""The networks that ITRA is built from: a four-layer CNN for views, and small MLPs."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from geoaim.simulation.kinematics import agent_from_world

CNN_WIDTHS = (16, 32, 48, 64)
NEIGHBOUR_INPUTS = 14
VIEW_CONTRAST = 0.25  # standard deviation of a view's channels about their mean


def build_cnn(channels: int, size: int, features: int) -> nn.Sequential:
    """Build the view encoder: four convolutions of stride 2, and a linear layer.

    Weights start such that a view's contrast is preserved from layer to layer (He et al. 2015).
    With torch's defaults it shrinks a hundredfold, and models hardly learn to use the map.

    Args:
        channels: number of channels of a view.
        size: side of a view, pixels.
        features: width of the output.

    Returns:
        A module from views (B, channels, size, size) to features (B, features).

    >>> import torch
    >>> build_cnn(7, 64, 96)(torch.zeros(2, 7, 64, 64)).shape
    torch.Size([2, 96])
    """
    layers: list[nn.Module] = []
    for number, width in enumerate(CNN_WIDTHS):
        kernel = 5 if number == 0 else 3
        conv = nn.Conv2d(channels, width, kernel, 2, kernel // 2)
        nn.init.kaiming_normal_(conv.weight, nonlinearity="relu")
        if number == 0:
            conv.weight.data *= 1 / VIEW_CONTRAST
        layers += [conv, nn.ReLU()]
        channels = width
    side = -(-size // 2 ** len(CNN_WIDTHS))
    return nn.Sequential(*layers, nn.Flatten(), nn.Linear(channels * side**2, features), nn.ReLU())


def build_mlp(inputs: int, width: int, outputs: int) -> nn.Sequential:
    """Build a network with two hidden layers.

    Args:
        inputs: width of the input.
        width: width of both hidden layers.
        outputs: width of the output.

    Returns:
        A module from (..., inputs) to (..., outputs).
    """
    return nn.Sequential(
        nn.Linear(inputs, width),
        nn.ReLU(),
        nn.Linear(width, width),
        nn.ReLU(),
        nn.Linear(width, outputs),
    )


class NeighbourEncoder(nn.Module):
    """Encodes the nearest other agents as numbers: where they are, and how they move.

    A learned function of each of them is maximized over all (Zaheer et al. 2017), so that their
    order does not matter. It starts at 0, as what is added to a trained model's features.

    Args:
        count: nearest agents that are encoded, those near to where an agent is in a second.
        width: width of the hidden layers.
        outputs: width of the output.
    """

    def __init__(self, count: int, width: int, outputs: int) -> None:
        super().__init__()
        self.count = count
        self.each = build_mlp(NEIGHBOUR_INPUTS, width, width)
        self.out = nn.Linear(width, outputs)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(
        self,
        pose: Float[Tensor, "E 4"],
        size: Float[Tensor, "E 2"],
        others: Float[Tensor, "E n 4"],
        sizes: Float[Tensor, "E n 2"],
        there: Bool[Tensor, "E n"],
    ) -> Float[Tensor, "E F"]:
        """Encode others (x, y, heading, speed; length, width) that are there, as agents see them.

        Args:
            pose: states of E agents.
            size: their lengths and widths.
            others: states of the n others of each, itself among them but not `there`.
            sizes: their lengths and widths.
            there: which of them count.

        Returns:
            The features, 0 where there is nobody.
        """
        local = agent_from_world(pose[:, None], others[..., :2])  # (E, n, 2)
        ahead = torch.stack([pose[:, 3], torch.zeros_like(pose[:, 3])], dim=1)[:, None]
        away = (local - ahead).detach().norm(dim=2).masked_fill(~there, torch.inf)
        away, index = away.topk(min(self.count, others.shape[1]), dim=1, largest=False)
        row = torch.arange(len(pose), device=pose.device)[:, None]
        local, other, box = local[row, index], others[row, index], sizes[row, index]
        turn = other[..., 2] - pose[:, None, 2]
        along, across = other[..., 3] * turn.cos(), other[..., 3] * turn.sin()
        gap = local[..., 0] - (box[..., 0] + size[:, None, 0]) / 2
        own = pose[:, None, 3].expand_as(gap)
        near = 4 / (4 + gap.clamp_min(0))
        numbers = [
            *(local[..., 0] / 20, local[..., 1] / 5, gap / 10, near, local[..., 1] * near),
            *(turn.cos(), turn.sin(), along / 10, across / 10, own / 10),
            *((own - along) / 5, (own - along) * near, box[..., 0] / 5, box[..., 1] / 2),
        ]
        known = torch.isfinite(away)[..., None]
        inputs = torch.where(known, torch.stack(numbers, dim=-1), 0.0)
        encoded = torch.where(known, self.each(inputs).relu(), 0.0).amax(dim=1)
        return self.out(encoded)
