"""Encoders of views: the four-layer CNN, and ResNet-18 (He et al. 2016) from scratch."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

WIDTHS = (16, 32, 48, 64)  # of the CNN's layers
CONTRAST = 0.25  # of views, about their middle
STAGES = (64, 128, 256, 512)  # of ResNet-18


def make_encoder(name: str, channels: int, size: int, features: int) -> nn.Module:
    """An encoder of square views by its name, "cnn" or "resnet18".

    Raises:
        ValueError: there is no such encoder.
    """
    if name == "cnn":
        return plain_cnn(channels, size, features)
    if name == "resnet18":
        return resnet18(channels, features)
    raise ValueError(f"there is no encoder {name!r}; there are cnn and resnet18")


def plain_cnn(channels: int, size: int, features: int) -> nn.Sequential:
    """Four convolutions that halve the view, and a linear layer.

    Weights start so that a view's contrast arrives undiminished (He et al. 2015): with torch's own
    start it shrinks a hundredfold on the way, and a model never comes to use its map.

    >>> plain_cnn(7, 64, 96)(torch.zeros(2, 7, 64, 64)).shape
    torch.Size([2, 96])
    """
    layers: list[nn.Module] = []
    for number, width in enumerate(WIDTHS):
        kernel = 5 if number == 0 else 3
        conv = nn.Conv2d(channels, width, kernel, 2, kernel // 2)
        nn.init.kaiming_normal_(conv.weight, nonlinearity="relu")
        if number == 0:
            conv.weight.data *= 1 / CONTRAST
        layers += [conv, nn.ReLU()]
        channels = width
    side = -(-size // 2 ** len(WIDTHS))
    return nn.Sequential(*layers, nn.Flatten(), nn.Linear(channels * side**2, features), nn.ReLU())


def resnet18(channels: int, features: int) -> nn.Sequential:
    """The residual network of 18 layers, with groups of channels normalised in place of batches.

    A batch here is steps of one rollout, whose statistics would leak from agent to agent and
    differ between training and use; group normalisation (Wu and He 2018) has no such state.

    >>> resnet18(7, 96)(torch.zeros(1, 7, 64, 64)).shape
    torch.Size([1, 96])
    """
    first = nn.Conv2d(channels, STAGES[0], 7, 2, 3, bias=False)
    layers: list[nn.Module] = [first, _norm(STAGES[0]), nn.ReLU(), nn.MaxPool2d(3, 2, 1)]
    before = STAGES[0]
    for number, width in enumerate(STAGES):
        layers += [_Residual(before, width, 1 if number == 0 else 2), _Residual(width, width, 1)]
        before = width
    head = [nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(before, features), nn.ReLU()]
    return nn.Sequential(*layers, *head)


class _Residual(nn.Module):
    def __init__(self, before: int, width: int, stride: int) -> None:
        super().__init__()
        self.way = nn.Sequential(
            nn.Conv2d(before, width, 3, stride, 1, bias=False),
            _norm(width),
            nn.ReLU(),
            nn.Conv2d(width, width, 3, 1, 1, bias=False),
            _norm(width),
        )
        self.short: nn.Module = nn.Identity()
        if stride > 1 or before != width:
            conv = nn.Conv2d(before, width, 1, stride, bias=False)
            self.short = nn.Sequential(conv, _norm(width))

    def forward(self, x: Float[Tensor, "B C H W"]) -> Tensor:
        return torch.relu(self.way(x) + self.short(x))


def _norm(width: int) -> nn.GroupNorm:
    return nn.GroupNorm(16, width)
