"""The networks that ITRA is built from: a four-layer CNN for views, and small MLPs."""

from torch import nn

CNN_WIDTHS = (16, 32, 48, 64)
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
