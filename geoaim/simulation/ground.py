"""The ground of bird's-eye views: a texture, sampled at the pixels of all views at once.

`View` is the size of a view. Its defaults are those of who renders: `geoaim.cli.simulate` for
videos, `geoaim.prediction.config` for what a model sees.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

GREY = 0.5


@dataclass(frozen=True)
class View:
    """The size of a bird's-eye view, in which the heading of its camera is up.

    Raises:
        ValueError: a side or the resolution is not positive.
    """

    height: int  # pixels
    width: int  # pixels
    resolution: float  # metres per pixel

    def __post_init__(self) -> None:
        if self.height < 1 or self.width < 1 or not 0 < self.resolution < math.inf:
            raise ValueError(
                f"{self}: sides of a pixel or more and a resolution above 0 are needed"
            )


@dataclass(frozen=True, eq=False)
class Ground:
    """A texture and its place in the world."""

    # the texture, with a border of one pixel in the colour beyond its edges
    image: Float[Tensor, "C h w"]
    # 1 where the texture shows the ground, 0 where not and in the border
    coverage: Float[Tensor, "1 h w"]
    image_from_world: Float[Tensor, "2 3"]  # metres to pixels (corner origin)
    averaged_over: float = 0.0  # metres to a side, by `prefilter_ground`; 0: not averaged

    @property
    def bounds(self) -> Float[Tensor, "2 2"]:
        """Lowest and highest x and y of the texture, metres."""
        height, width = self.image.shape[1:]
        pixels = torch.tensor([[0, 0], [width, 0], [width, height], [0, height]])
        corners = world_from_pixels(self.image_from_world, pixels)
        return torch.stack([corners.amin(dim=0), corners.amax(dim=0)])


def make_ground(
    image: Float[Tensor, "C h w"],
    image_from_world: Float[Tensor, "2 3"],
    *,
    coverage: Bool[Tensor, "h w"] | None = None,
    outside: Float[Tensor, "C"] | None = None,
) -> Ground:
    """Make a ground of a texture.

    Args:
        image: (C, h, w) a map's image, 0 to 1, in float32 or float64. For no map: (C, 1, 1) of one
            colour, with `outside` the same colour.
        image_from_world: (2, 3) metres to its pixels (corner origin, v down).
        coverage: (h, w) where the image shows the ground; None: everywhere.
        outside: (C,) colour where it does not, and beyond the image; None: mid-grey.

    Returns:
        The ground, of the image's dtype and on its device.

    Raises:
        ValueError: the transform is singular, the image has another dtype or a number that is not
            finite, or shapes do not match.
    """
    if coverage is None:
        coverage = torch.ones_like(image[0], dtype=torch.bool)
    if outside is None:
        outside = torch.full_like(image[:, 0, 0], GREY)
    if not torch.isfinite(image_from_world).all() or _compute_resolution(image_from_world) == 0:
        raise ValueError(f"image_from_world is {image_from_world.tolist()}; it must be invertible")
    if image.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"a texture of {image.dtype}; float32 or float64 is needed")
    if not torch.isfinite(image).all():
        raise ValueError("the texture has pixels that are not finite")
    if coverage.shape != image.shape[1:] or len(outside) != len(image):
        raise ValueError(
            f"the texture has the shape {tuple(image.shape)}, its mask {tuple(coverage.shape)} and "
            f"the colour outside {len(outside)} channels; height, width and channels must be equal"
        )
    covered = torch.where(coverage, image, outside[:, None, None])
    share = coverage.to(image)[None]
    matrix = _shift_origin(image_from_world.to(image), 1.0)
    border = torch.zeros_like(share[:, 0, 0])
    return Ground(_add_border(covered, outside), _add_border(share, border), matrix)


def move_ground(ground: Ground, device: torch.device | str) -> Ground:
    """Move a ground to a device; the result is another object."""
    return replace(
        ground,
        image=ground.image.to(device),
        coverage=ground.coverage.to(device),
        image_from_world=ground.image_from_world.to(device),
    )


def prefilter_ground(ground: Ground, resolution: float) -> Ground:
    """Average a ground over pixels of `resolution` metres, so that views of it do not alias.

    A ground that is averaged over as much already is returned as it is. Each pixel becomes the mean
    of the texture, interpolated by cubic convolution (Keys 1981), over a square of one of the
    view's pixels. One bilinear lookup is then close to the mean over it, however the view is
    turned. A texture much finer than the view is subsampled to four pixels for each of the view's,
    with a smaller square for the blur of looking up among fewer pixels. The texture's pixels must
    be about square.
    """
    if ground.averaged_over >= resolution:
        return ground
    ratio = resolution / _compute_resolution(ground.image_from_world)
    stride = max(1, int(ratio / 4 + 1e-3))
    weights = _compute_weights(math.sqrt(ratio**2 - 2 * (stride**2 - 1)))
    margin = math.ceil(len(weights) / 2 / stride) * stride  # the filter spreads beyond the edges
    matrix = _shift_origin(_shift_origin(ground.image_from_world, margin - 1.5) / stride, 0.5 + 1)
    image, coverage = (
        _filter(plane, weights, stride, margin) for plane in (ground.image, ground.coverage)
    )
    return Ground(image, coverage, matrix, averaged_over=resolution)


def render_coverage(
    view: View, cameras: Float[Tensor, "B 3"], ground: Ground
) -> Float[Tensor, "B 1 H W"]:
    """Render how much of each pixel the map covers.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3) x, y, heading of the pictures' centres.
        ground: the map.

    Returns:
        (B, 1, H, W) from 0, beyond the map and in its gaps, to 1; without gradients.
    """
    with torch.no_grad():
        share = sample_ground(view, cameras, ground.coverage, ground.image_from_world)
    return unflatten_views(share.clamp(0, 1), view)


def sample_ground(
    view: View,
    cameras: Float[Tensor, "B 3"],
    image: Float[Tensor, "C h w"],
    image_from_world: Float[Tensor, "2 3"],
) -> Float[Tensor, "C P"]:
    """Sample a texture bilinearly at the centres of all pixels of all views.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3) x, y, heading.
        image: (C, h, w) the texture.
        image_from_world: (2, 3) metres to its pixels (corner origin).

    Returns:
        (C, P) with P = B H W, one view after the other; beyond the texture its border.
    """
    height, width = image.shape[-2:]
    scale = image.new_tensor([2 / width, 2 / height])  # grid_sample: -1 to 1
    linear, offset = image_from_world[:, :2] * scale[:, None], image_from_world[:, 2] * scale - 1
    cosine, sine = cameras[:, 2].cos(), cameras[:, 2].sin()
    right = apply_matrix(linear, torch.stack([sine, -cosine], dim=1))  # (B, 2) for a metre
    down = apply_matrix(linear, torch.stack([-cosine, -sine], dim=1))
    centre = apply_matrix(linear, cameras[:, :2])
    columns, rows = (
        (torch.arange(count).to(cameras) + 0.5 - count / 2) * view.resolution
        for count in (view.width, view.height)
    )
    # (B, 2 W) both coordinates of each column in turn, the layout that grid_sample reads
    across = (columns[:, None] * right[:, None] + (centre + offset)[:, None]).flatten(1)
    grid = torch.addcmul(across[:, None], rows[None, :, None], down.repeat(1, view.width)[:, None])
    grid = grid.view(1, len(cameras) * view.height, view.width, 2)
    pixels = F.grid_sample(image[None], grid, padding_mode="border", align_corners=False)
    return pixels.view(len(image), len(cameras) * view.height * view.width)


def world_from_pixels(
    image_from_world: Float[Tensor, "2 3"], pixels: Tensor
) -> Float[Tensor, "n 2"]:
    """Map pixels (n, 2) to metres, in float64."""
    matrix = image_from_world.double()
    return torch.linalg.solve(matrix[:, :2], (pixels.to(matrix) - matrix[:, 2]).t()).t()


def apply_matrix(
    matrix: Float[Tensor, "2 2"], vectors: Float[Tensor, "... 2"]
) -> Float[Tensor, "... 2"]:
    """Multiply each vector by one matrix, by sums: autocast and TF32 round matrix products."""
    return (matrix * vectors[..., None, :]).sum(-1)


def unflatten_views(flat: Float[Tensor, "C P"], view: View) -> Float[Tensor, "B C H W"]:
    """Reshape the pixels of `sample_ground` to pictures."""
    return flat.view(len(flat), -1, view.height, view.width).transpose(0, 1)


def _filter(
    image: Float[Tensor, "C h w"], weights: list[float], stride: int, margin: int
) -> Float[Tensor, "C H W"]:
    """Filter an image with a border, and a margin around it, by a separable filter."""
    outside, radius = image[:, 0, 0], len(weights) // 2
    result = F.pad(image[:, 1:-1, 1:-1] - outside[:, None, None], (margin + radius,) * 4)
    for _ in range(2):  # rows, then columns; a convolution takes many times the texture's memory
        end = result.shape[1] - 2 * radius
        shifts = (result[:, k : k + end : stride] for k in range(len(weights)))
        result = _sum_weighted(shifts, weights).transpose(1, 2)
    return _add_border((result + outside[:, None, None]).contiguous(), outside)


def _sum_weighted(images: Iterator[Tensor], weights: list[float]) -> Tensor:
    total = next(images) * weights[0]
    for image, weight in zip(images, weights[1:], strict=True):
        total = total + image * weight if image.requires_grad else total.add_(image, alpha=weight)
    return total


def _compute_weights(side: float) -> list[float]:
    """Compute the filter of a mean over `side` pixels of the cubic convolution (Keys 1981)."""
    radius = math.ceil(side / 2 + 1.5)
    ends = torch.arange(-radius, radius + 1)[:, None] + torch.tensor([-side, side]).double() / 2
    x = ends.abs().clamp(max=2)
    near = x * (1 + x**2 * (3 / 8 * x - 5 / 6))  # the kernel's integral from 0 to x, to 1
    far = 2 * x - 2 * x**2 + 5 / 6 * x**3 - x**4 / 8 - 1 / 6  # and beyond
    weights = (torch.where(x < 1, near, far) * ends.sign()).diff(dim=1)[:, 0]
    return (weights / weights.sum()).tolist()


def _add_border(
    image: Float[Tensor, "C h w"], colour: Float[Tensor, "C"]
) -> Float[Tensor, "C H W"]:
    colour = colour[:, None, None]
    return F.pad(image - colour, (1, 1, 1, 1)) + colour


def _shift_origin(image_from_world: Float[Tensor, "2 3"], pixels: float) -> Float[Tensor, "2 3"]:
    """Move an image's origin by `pixels` up and to the left."""
    return image_from_world + F.pad(image_from_world.new_full((2, 1), pixels), (2, 0))


def _compute_resolution(image_from_world: Float[Tensor, "2 3"]) -> float:
    """Compute metres per pixel; 0 of a singular transform."""
    area = abs(float(torch.linalg.det(image_from_world[:, :2].double())))
    return 1 / math.sqrt(area) if area > 0 else 0.0
