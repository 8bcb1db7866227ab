"""ResNet-18 (He et al. 2016) as encoder of views, from scratch."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

STAGE_WIDTHS = (64, 128, 256, 512)
NORM_GROUPS = 16


def build_resnet18(channels: int, size: int, features: int) -> nn.Sequential:
    """Build ResNet-18 with group normalisation instead of batch normalisation.

    A batch here is the steps of a rollout: its statistics would leak between agents, and differ
    between training and use. Group normalisation (Wu and He 2018) has no such state.

    Args:
        channels: of a view.
        size: side of a view, pixels; any.
        features: width of the output.

    Returns:
        A module from views (B, channels, size, size) to features (B, features).

    >>> build_resnet18(7, 64, 96)(torch.zeros(1, 7, 64, 64)).shape
    torch.Size([1, 96])
    """
    stem = nn.Conv2d(channels, STAGE_WIDTHS[0], 7, 2, 3, bias=False)
    layers: list[nn.Module] = [stem, _make_norm(STAGE_WIDTHS[0]), nn.ReLU(), nn.MaxPool2d(3, 2, 1)]
    before = STAGE_WIDTHS[0]
    for number, width in enumerate(STAGE_WIDTHS):
        layers += [_Residual(before, width, 1 if number == 0 else 2), _Residual(width, width, 1)]
        before = width
    head = [nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(before, features), nn.ReLU()]
    return nn.Sequential(*layers, *head)


class _Residual(nn.Module):
    def __init__(self, before: int, width: int, stride: int) -> None:
        super().__init__()
        self.branch = nn.Sequential(
            nn.Conv2d(before, width, 3, stride, 1, bias=False),
            _make_norm(width),
            nn.ReLU(),
            nn.Conv2d(width, width, 3, 1, 1, bias=False),
            _make_norm(width),
        )
        self.shortcut: nn.Module = nn.Identity()
        if stride > 1 or before != width:
            conv = nn.Conv2d(before, width, 1, stride, bias=False)
            self.shortcut = nn.Sequential(conv, _make_norm(width))

    def forward(self, x: Float[Tensor, "B C H W"]) -> Tensor:
        return torch.relu(self.branch(x) + self.shortcut(x))


def _make_norm(width: int) -> nn.GroupNorm:
    return nn.GroupNorm(NORM_GROUPS, width)
