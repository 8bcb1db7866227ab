"""The network of the detector, in torch, and its export to the file that is shipped."""

from jaxtyping import Float
from torch import Tensor, nn

STRIDE = 4  # pixels of a cell of the output
CHANNELS = 9  # heat; offset 2; log length, log width; cos, sin of the double and the plain heading


def _convolve(
    inputs: int, outputs: int, stride: int = 1, dilation: int = 1, size: int = 3
) -> nn.Module:
    pad = dilation * (size // 2)
    layer = nn.Conv2d(inputs, outputs, size, stride, pad, dilation, bias=False)
    return nn.Sequential(layer, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


class Network(nn.Module):
    """Most of the work is done at an eighth of the picture's size: a core is fast enough."""

    def __init__(self, fine: int = 32, coarse: int = 64) -> None:
        super().__init__()
        self.first = _convolve(3, 16, stride=2, size=5)
        layers = [_convolve(16, fine, stride=2), *(_convolve(fine, fine) for _ in range(3))]
        self.fine = nn.Sequential(*layers)
        dilations = (1, 2, 4, 1)
        layers = [_convolve(fine, coarse, stride=2)]
        layers += [_convolve(coarse, coarse, dilation=d) for d in dilations]
        self.coarse = nn.Sequential(*layers)
        self.up = nn.ConvTranspose2d(coarse, fine, 2, 2)
        self.head = nn.Sequential(_convolve(fine, 2 * fine), nn.Conv2d(2 * fine, CHANNELS, 1))
        bias = self.head[-1].bias
        assert isinstance(bias, Tensor)
        nn.init.constant_(bias[:1], -4.0)

    def forward(self, image: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B 9 H/4 W/4"]:
        """Compute the output of RGB in [0, 1]; height and width are multiples of 8."""
        fine = self.fine(self.first(image))
        return self.head(fine + self.up(self.coarse(fine)))
