"""The ground: textures of maps, where they lie in the world, and moves to other worlds."""

import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.base.errors import MapError
from geoaim.base.world import World, describe_world

GREY = 0.5
MAX_BRIGHTNESS = 2.0  # interpolation may exceed 1 a little; colours from 0 to 255 exceed this
MAX_FLOAT_SPACING_PX = 0.25  # largest spacing of neighbouring floats at a map, in its pixels


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
    """The textures of M maps in one image, and the place of each in its world.

    A batch of views shows one map if M is 1, else one map for each view: `select` chooses them.

    Attributes:
        image: (C, h, w) the textures, 0 to 1, each with a border of one pixel in the colour beyond
            its edges; channels last in memory.
        coverage: (1, h, w) 1 where a texture shows the ground, 0 where not and in the border.
        image_from_world: (M, 2, 3) metres of each map to pixels (corner origin).
        regions: (M, 4) left, top, right and bottom edge of each texture in the image, with its
            border, pixels.
        averaged_over: metres to a side, by `prefilter_ground`; 0: not averaged.
        finest: metres per pixel of the finest texture; infinite: not known, or a plain colour.
        world: the plane of the metres of all maps; None: not known, or there are several.

    Raises:
        ValueError: a transform is not finite, or a region lies beyond the image.
    """

    image: Float[Tensor, "C h w"]
    coverage: Float[Tensor, "1 h w"]
    image_from_world: Float[Tensor, "M 2 3"]
    regions: Int[Tensor, "M 4"]
    averaged_over: float = 0.0
    finest: float = math.inf
    world: World | None = None

    def __post_init__(self) -> None:
        limits = self.regions.new_tensor(self.image.shape[:0:-1]).repeat(2)
        is_inside = (self.regions >= 0) & (self.regions <= limits)
        if not (is_inside.all() and torch.isfinite(self.image_from_world).all()):
            raise ValueError(
                "the ground's image_from_world is not finite, or its regions lie beyond its image; "
                "make it by `make_ground`"
            )

    @property
    def bounds(self) -> Float[Tensor, "M 2 2"]:
        """Lowest and highest x and y of each texture, metres."""
        left, top, right, bottom = self.regions.unbind(1)
        pixels = torch.stack([left, top, right, top, right, bottom, left, bottom], dim=1)
        corners = world_from_pixels(self.image_from_world, pixels.view(-1, 4, 2))
        return torch.stack([corners.amin(dim=1), corners.amax(dim=1)], dim=1)

    def select(self, maps: Int[Tensor, "B"]) -> "Ground":
        """Choose the map of each of B views; the textures stay as they are."""
        return replace(
            self, image_from_world=self.image_from_world[maps], regions=self.regions[maps]
        )

    def to(
        self, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> "Ground":
        """Move the textures to a device, or convert them to a dtype."""
        return replace(
            self,
            image=self.image.to(device=device, dtype=dtype),
            coverage=self.coverage.to(device=device, dtype=dtype),
            image_from_world=self.image_from_world.to(device=device, dtype=dtype),
            regions=self.regions.to(device=device),
        )


def make_ground(
    image: Float[Tensor, "*M C h w"],
    image_from_world: Float[Tensor, "*M r 3"],
    *,
    coverage: Bool[Tensor, "*M h w"] | None = None,
    outside: Float[Tensor, "C"] | None = None,
) -> Ground:
    """Make a ground of a texture, or of a batch of textures of one size.

    Args:
        image: (C, h, w) a map's image, 0 to 1, in float32 or float64, or (M, C, h, w) the images of
            M maps. One pixel, (C, 1, 1), is a plain colour.
        image_from_world: (2, 3) or (3, 3) metres to its pixels (corner origin, v down), affine; or
            (M, 2, 3) or (M, 3, 3).
        coverage: (h, w) or (M, h, w) where the image shows the ground; None: everywhere.
        outside: (C,) colour where it does not, and beyond the image; None: mid-grey, or for one
            pixel its own colour.

    Returns:
        The ground, of the image's dtype and on its device.

    Raises:
        ValueError: a transform is singular or not affine, the image has another dtype, a number
            that is not finite or colours from 0 to 255, shapes do not match, or a map lies so far
            from its world's origin that positions in its dtype are inexact.

    >>> maps = make_ground(torch.zeros(2, 3, 8, 8), torch.eye(3).expand(2, 3, 3))
    >>> maps.image.shape, maps.regions.tolist()
    (torch.Size([3, 20, 10]), [[0, 0, 10, 10], [0, 10, 10, 20]])
    """
    images, matrices = image[(None,) * (4 - image.ndim)], _check_matrices(image_from_world)
    channels, height, width = images.shape[1:]
    if coverage is None:
        coverage = torch.ones_like(images[:, 0], dtype=torch.bool)
    colour = images.new_full((1, channels, 1, 1), GREY)
    is_plain = height == width == 1
    if outside is not None:
        colour = outside.to(images).view(1, -1, 1, 1)
    elif is_plain:
        colour = images
    _check_images(images, coverage, colour.shape[1], len(matrices))
    _check_near(matrices, images.dtype)
    coverage = coverage.view(-1, 1, height, width)
    bordered = F.pad(torch.where(coverage, images - colour, 0.0), (1, 1, 1, 1)) + colour
    # one below the other
    count, rows, columns = len(images), height + 2, width + 2
    tops = rows * torch.arange(count, device=images.device)
    # column and row of each map's first pixel
    offsets = torch.stack([torch.ones_like(tops), tops + 1], dim=1)
    matrices = matrices.to(images) + F.pad(offsets.to(images)[..., None], (2, 0))
    stacked = bordered.permute(0, 2, 3, 1).contiguous().view(count * rows, columns, channels)
    return Ground(
        image=stacked.permute(2, 0, 1),
        coverage=F.pad(coverage.to(images), (1, 1, 1, 1)).view(1, count * rows, columns),
        image_from_world=matrices,
        regions=torch.stack([tops * 0, tops, torch.full_like(tops, columns), tops + rows], dim=1),
        finest=math.inf
        if is_plain or not count
        else float(compute_resolutions(matrices.detach()).min()),
    )


def _check_matrices(image_from_world: Float[Tensor, "*M r 3"]) -> Float[Tensor, "M 2 3"]:
    """Refuse transforms that cannot be inverted, or that are not affine."""
    matrices = image_from_world[(None,) * (3 - image_from_world.ndim)]
    last = matrices[:, 2:] - matrices.new_tensor([0.0, 0.0, 1.0])
    matrices = matrices[:, :2]
    if not torch.isfinite(matrices).all() or not (compute_resolutions(matrices) > 0).all():
        raise ValueError(f"image_from_world is {image_from_world.tolist()}; it must be invertible")
    if last.numel() and last.abs().max() > 1e-6:
        raise ValueError(
            f"image_from_world is {image_from_world.tolist()}; its last row must be 0, 0, 1: use "
            "`ground_from_corners` for an image in perspective"
        )
    return matrices


def _check_images(
    images: Float[Tensor, "M C h w"], coverage: Bool[Tensor, "*M h w"], outside: int, matrices: int
) -> None:
    """Refuse textures that would give a wrong picture."""
    if images.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"a texture of {images.dtype}; float32 or float64 is needed")
    if not torch.isfinite(images).all():
        raise ValueError("the texture has pixels that are not finite")
    darkest, brightest = (float(x) for x in images.detach().aminmax()) if images.numel() else (0, 0)
    if darkest >= 0 and brightest > MAX_BRIGHTNESS:
        raise ValueError(
            f"the texture has values up to {brightest:g}; colours are from 0 to 1: divide those "
            "from 0 to 255 by 255"
        )
    if coverage.shape[-2:] != images.shape[-2:] or outside != images.shape[1]:
        raise ValueError(
            f"the texture has the shape {tuple(images.shape[1:])}, its mask "
            f"{tuple(coverage.shape)} and the colour outside {outside} channels; height, "
            "width and channels must be equal"
        )
    if not len(images) == matrices == coverage.numel() // coverage.shape[-2:].numel():
        raise ValueError(
            f"there are {len(images)} textures, {matrices} transforms, and masks of shape "
            f"{tuple(coverage.shape)}; give as many of each"
        )


def _check_near(matrices: Float[Tensor, "M 2 3"], dtype: torch.dtype) -> None:
    """Refuse maps so far from their world's origin that positions in a dtype are inexact."""
    far = float(matrices[..., 2].detach().abs().max()) if len(matrices) else 0.0
    if far * torch.finfo(dtype).eps > MAX_FLOAT_SPACING_PX:
        raise ValueError(
            f"a map lies {far:,.0f} of its pixels from its world's origin, where {dtype} has steps "
            f"of {far * torch.finfo(dtype).eps:.1f} pixels; subtract an origin near it from all "
            "positions, or give float64"
        )


def world_from_pixels(
    image_from_world: Float[Tensor, "*M 2 3"], pixels: Tensor
) -> Float[Tensor, "*M n 2"]:
    """Map pixels (..., n, 2) to metres, in float64."""
    matrix = image_from_world.double()
    offset = pixels.to(matrix) - matrix[..., None, :, 2]
    return torch.linalg.solve(matrix[..., :2], offset.mT).mT


def compute_resolutions(image_from_world: Float[Tensor, "*M 2 3"]) -> Float[Tensor, "*M"]:
    """Compute metres per pixel of transforms, in float64; 0 of a singular one."""
    area = torch.linalg.det(image_from_world[..., :2].double()).abs()
    return torch.where(area > 0, 1 / area.clamp_min(1e-300).sqrt(), 0.0)


def apply_matrix(
    matrix: Float[Tensor, "... 2 2"], vectors: Float[Tensor, "... 2"]
) -> Float[Tensor, "... 2"]:
    """Multiply vectors by matrices, by sums: autocast and TF32 round matrix products."""
    return (matrix * vectors[..., None, :]).sum(-1)


def find_offset(source: World | None, target: World | None, name: str) -> tuple[float, float]:
    """Find what has to be added to x and y of one world to have them in another.

    Args:
        source: the world of the data; None: not known, taken to be the target.
        target: the world to move to; None: not known, taken to be the source.
        name: what the data are called in the message.

    Returns:
        Metres east and north.

    Raises:
        MapError: the two have different CRSs, between which no shift is exact, or are two local
            planes with different origins.

    >>> find_offset(World("EPSG:32635", (10.0, 0.0)), World("EPSG:32635", (4.0, 1.0)), "lanes")
    (6.0, -1.0)
    """
    if source is None or target is None or source == target:
        return 0.0, 0.0
    if source.crs != target.crs or source.crs is None:
        raise MapError(
            f"the {name} lie in {describe_world(source)}, and are needed in "
            f"{describe_world(target)}; read or make them in that world, such as by "
            "read_hdmap(path, aim.world)"
        )
    (east, north), (there_east, there_north) = source.origin, target.origin
    return east - there_east, north - there_north


def move_transform(pixels_from_world: torch.Tensor, offset: tuple[float, float]) -> torch.Tensor:
    """Change transforms (..., 2, 3) from a world to those from a world moved by an offset."""
    matrix = pixels_from_world.double()
    shift = (matrix[..., :2] * matrix.new_tensor(offset)).sum(-1, keepdim=True)
    return (matrix - F.pad(shift, (2, 0))).to(pixels_from_world)


def move_ground(ground: Ground, world: World | None) -> Ground:
    """Move a ground to a world of the same CRS; one whose world is not known stays where it is.

    Raises:
        MapError: the move would not be exact.
    """
    offset = find_offset(ground.world, world, "maps")
    if offset == (0.0, 0.0):
        return ground
    return replace(
        ground, image_from_world=move_transform(ground.image_from_world, offset), world=world
    )
