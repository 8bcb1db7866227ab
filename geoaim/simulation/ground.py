"""The ground of bird's-eye views: a texture, looked up at the pixels of all views at once."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

GREY = 0.5


@dataclass(frozen=True)
class View:
    """The picture of a camera: what is ahead of it is up.

    Attributes:
        height: pixels.
        width: pixels.
        resolution: metres a pixel.

    Raises:
        ValueError: a side or the resolution is not positive.
    """

    height: int
    width: int
    resolution: float

    def __post_init__(self) -> None:
        if self.height < 1 or self.width < 1 or not 0 < self.resolution < math.inf:
            raise ValueError(
                f"{self}: sides of a pixel or more and a resolution above 0 are needed"
            )


@dataclass(frozen=True, eq=False)
class Ground:
    """A texture and where it lies.

    Attributes:
        image: (C, H, W) the texture, in a frame of one pixel of what is seen where it ends.
        known: (1, H, W) where it shows the ground: 1, and 0 where it does not, and in the frame.
        image_from_world: (2, 3) metres to its pixels (corner origin).
    """

    image: Float[Tensor, "C h w"]
    known: Float[Tensor, "1 h w"]
    image_from_world: Float[Tensor, "2 3"]


def make_ground(
    image: Float[Tensor, "C h w"],
    image_from_world: Float[Tensor, "2 3"],
    *,
    known: Bool[Tensor, "h w"] | None = None,
    outside: Float[Tensor, "C"] | None = None,
) -> Ground:
    """A ground from a texture.

    Args:
        image: a map's picture, or a plain colour (C, 1, 1) for no map.
        image_from_world: metres to its pixels (corner origin).
        known: where the texture shows the ground; None: everywhere.
        outside: colour of what is not known and of what lies beyond the texture; None: mid-grey.

    Raises:
        ValueError: the transform is singular, a number is not finite, or shapes do not match.
    """
    if not torch.isfinite(image_from_world).all() or _metres_per_pixel(image_from_world) == 0:
        raise ValueError(f"image_from_world is {image_from_world.tolist()}; it must be invertible")
    if image.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"a texture of {image.dtype}; float32 or float64 is needed")
    if not torch.isfinite(image).all():
        raise ValueError("the texture has pixels that are not finite")
    if known is None:
        known = torch.ones_like(image[0], dtype=torch.bool)
    if outside is None:
        outside = torch.full_like(image[:, 0, 0], GREY)
    if known.shape != image.shape[1:] or len(outside) != len(image):
        raise ValueError(
            f"a texture of {tuple(image.shape)} with a mask of {tuple(known.shape)} and an "
            f"outside of {len(outside)} channels"
        )
    seen = torch.where(known, image, outside[:, None, None])
    share = known.to(image)[None]
    matrix = _shifted(image_from_world.to(image), 1.0)
    return Ground(_framed(seen, outside), _framed(share, torch.zeros_like(share[:, 0, 0])), matrix)


def on_device(ground: Ground, device: torch.device | str) -> Ground:
    """The same ground on another device."""
    return Ground(
        ground.image.to(device), ground.known.to(device), ground.image_from_world.to(device)
    )


def fit_ground(ground: Ground, resolution: float) -> Ground:
    """The ground for views of so many metres a pixel: averaged beforehand over a view's pixel.

    A texture finer than the view would shimmer. Once each of its pixels is the mean over a square
    of the view's pixel, of the texture between its pixels by cubic convolution (Keys 1981), one
    linear lookup a pixel is close to the mean over that pixel, however the view is turned. Of what
    is then too fine, four pixels for each of the view's are kept, and the square is made smaller
    by what looking up among fewer pixels blurs. The texture's pixels should be about as wide as
    high.
    """
    ratio = resolution / _metres_per_pixel(ground.image_from_world)
    step = max(1, int(ratio / 4 + 1e-3))
    weights = _square_mean(math.sqrt(ratio**2 - 2 * (step**2 - 1)))
    rim = math.ceil(len(weights) / 2 / step) * step  # what the mean spreads beyond the texture
    matrix = _shifted(_shifted(ground.image_from_world, rim - 1.5) / step, 0.5 + 1)
    image, known = (_averaged(plane, weights, step, rim) for plane in (ground.image, ground.known))
    return Ground(image, known, matrix)


def ground_share(
    view: View, cameras: Float[Tensor, "B 3"], ground: Ground
) -> Float[Tensor, "B 1 H W"]:
    """How much of each pixel shows ground that is known: 0 beyond the map's end and in its gaps."""
    with torch.no_grad():
        share = ground_seen(view, cameras, ground.known, ground.image_from_world)
    return unfolded(share.clamp(0, 1), view, cameras)


def ground_seen(
    view: View,
    cameras: Float[Tensor, "B 3"],
    image: Float[Tensor, "C h w"],
    matrix: Float[Tensor, "2 3"],
) -> Float[Tensor, "C P"]:
    """A texture in all pixels of all views, one view after the other."""
    height, width = image.shape[-2:]
    turn = matrix[:, :2] * image.new_tensor([[2 / width], [2 / height]])  # grid_sample: -1 to 1
    start = matrix[:, 2] * image.new_tensor([2 / width, 2 / height]) - 1
    cosine, sine = cameras[:, 2].cos(), cameras[:, 2].sin()
    right = applied(turn, torch.stack([sine, -cosine], dim=1))
    down = applied(turn, torch.stack([-cosine, -sine], dim=1))
    middle = applied(turn, cameras[:, :2])
    columns, rows = (
        (torch.arange(count).to(cameras) + 0.5 - count / 2) * view.resolution
        for count in (view.width, view.height)
    )
    across = (columns[:, None] * right[:, None] + (middle + start)[:, None]).flatten(1)
    ahead = down.repeat(1, view.width)  # rows of both coordinates in turn, as they lie in memory
    grid = torch.addcmul(across[:, None], rows[None, :, None], ahead[:, None])
    grid = grid.view(1, len(cameras) * view.height, view.width, 2)
    seen = F.grid_sample(image[None], grid, padding_mode="border", align_corners=False)
    return seen.view(len(image), len(cameras) * view.height * view.width)


def bounds_of(ground: Ground) -> Float[Tensor, "2 2"]:
    """Lowest and highest x and y of a ground's texture."""
    height, width = ground.image.shape[1:]
    pixels = torch.tensor([[0, 0], [width, 0], [width, height], [0, height]])
    corners = in_world(ground.image_from_world, pixels)
    return torch.stack([corners.amin(dim=0), corners.amax(dim=0)])


def in_world(image_from_world: Float[Tensor, "2 3"], pixels: Tensor) -> Float[Tensor, "n 2"]:
    """Metres of pixels, as float64."""
    exact = image_from_world.double()
    return torch.linalg.solve(exact[:, :2], (pixels.to(exact) - exact[:, 2]).t()).t()


def applied(
    matrix: Float[Tensor, "2 2"], vectors: Float[Tensor, "... 2"]
) -> Float[Tensor, "... 2"]:
    """The matrix times each vector, by sums: products of matrices may be rounded to half floats."""
    return (matrix * vectors[..., None, :]).sum(-1)


def unfolded(
    flat: Float[Tensor, "C P"], view: View, cameras: Float[Tensor, "B 3"]
) -> Float[Tensor, "B C H W"]:
    """Pictures of which all pixels stood in a row, one view after the other."""
    return flat.view(len(flat), len(cameras), view.height, view.width).transpose(0, 1)


def _averaged(
    image: Float[Tensor, "C h w"], weights: list[float], step: int, rim: int
) -> Float[Tensor, "C H W"]:
    """The image within its frame, and a rim, averaged at every so many pixels; framed again."""
    outside, reach = image[:, 0, 0], len(weights) // 2
    small = F.pad(image[:, 1:-1, 1:-1] - outside[:, None, None], (rim + reach,) * 4)
    for _ in range(2):  # rows, then columns; a convolution takes many times the texture's memory
        last = small.shape[1] - 2 * reach
        small = _weighted_sum((small[:, k : k + last : step] for k in range(len(weights))), weights)
        small = small.transpose(1, 2)
    return _framed((small + outside[:, None, None]).contiguous(), outside)


def _weighted_sum(parts: Iterator[Tensor], weights: list[float]) -> Tensor:
    total = next(parts) * weights[0]
    for part, weight in zip(parts, weights[1:], strict=True):
        total = total + part * weight if part.requires_grad else total.add_(part, alpha=weight)
    return total


def _square_mean(side: float) -> list[float]:
    """Weights of pixels in the mean over so many pixels of what cubic convolution puts between."""
    reach = math.ceil(side / 2 + 1.5)
    ends = torch.arange(-reach, reach + 1)[:, None] + torch.tensor([-side, side]).double() / 2
    x = ends.abs().clamp(max=2)
    near = x * (1 + x**2 * (3 / 8 * x - 5 / 6))
    far = 2 * x - 2 * x**2 + 5 / 6 * x**3 - x**4 / 8 - 1 / 6
    weights = (torch.where(x < 1, near, far) * ends.sign()).diff(dim=1)[:, 0]
    return (weights / weights.sum()).tolist()


def _framed(image: Float[Tensor, "C h w"], colour: Float[Tensor, "C"]) -> Float[Tensor, "C H W"]:
    """An image in a frame of one pixel."""
    colour = colour[:, None, None]
    return F.pad(image - colour, (1, 1, 1, 1)) + colour


def _shifted(matrix: Float[Tensor, "2 3"], pixels: float) -> Float[Tensor, "2 3"]:
    """The transform into an image whose corner has moved so many pixels up and to the left."""
    return matrix + F.pad(matrix.new_full((2, 1), pixels), (2, 0))


def _metres_per_pixel(image_from_world: Float[Tensor, "2 3"]) -> float:
    area = abs(float(torch.linalg.det(image_from_world[:, :2].double())))
    return 1 / math.sqrt(area) if area > 0 else 0.0
