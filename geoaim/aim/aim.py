"""AIM: an image of the ground and where it lies in the world."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, UInt8, UInt16
from numpy import ndarray as Array

from geoaim.aim.position import bind_report
from geoaim.aim.summary import summarize_report
from geoaim.base.displays import Display
from geoaim.base.errors import AimError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.grid import Grid
from geoaim.base.limits import MAX_POSITION_M
from geoaim.base.world import World, describe_world

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import DataArray


@dataclass(frozen=True, eq=False, repr=False)
class AIM(Display):
    """Aerial image-based map.

    Attributes:
        image: (H, W, 3) RGB.
        world_from_image: (3, 3) pixels (corner origin, u right, v down) to world metres.
        world: the plane that those metres lie in.
        coverage: (H, W) number of frames behind each pixel; 0 where the ground was not seen.
        contested: (H, W) pixels for which the frames do not agree on a background.
        report: how it was made and how accurate it is. Kept as plain JSON: arrays become lists,
            and numbers that do not exist (NaN, infinity) become None. What it states of the
            position holds for this place: a map that is moved (`replace(aim, world_from_image=...)`
            or by another program) says so.

    Raises:
        ValueError: a field has a wrong type or shape, or the matrix has no inverse.
        AimError: part of the image lies at or behind the horizon, or off the Earth.
    """

    image: UInt8[Array, "H W 3"]
    world_from_image: Float[Array, "3 3"]
    world: World
    coverage: UInt16[Array, "H W"]
    contested: Bool[Array, "H W"]
    report: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        height, width = (*np.shape(self.image), 0, 0)[:2]
        _check_array("image", self.image, np.uint8, (height, width, 3))
        _check_array("world_from_image", self.world_from_image, np.float64, (3, 3))
        _check_array("coverage", self.coverage, np.uint16, (height, width))
        _check_array("contested", self.contested, np.bool_, (height, width))
        if height * width == 0:
            raise ValueError(f"image has no pixels: its shape is {self.image.shape}")
        _check_transform(self.world_from_image, height, width)
        text = json.dumps(dict(self.report), default=lambda value: value.tolist())
        plain = json.loads(text, parse_constant=lambda _: None)
        object.__setattr__(self, "report", bind_report(plain, self.grid))

    def to_xarray(self) -> "DataArray":
        """Make an array of xarray in the CRS of the world, which rioxarray (`.rio`) knows."""
        import rioxarray  # noqa: F401, which adds .rio to arrays
        from rasterio import Affine
        from xarray import DataArray

        matrix = self.world_from_image
        aim = self
        if not self.is_affine or matrix[0, 1] or matrix[1, 0]:
            from geoaim.aim.rectification import rectify  # which imports this module

            aim = rectify(self)
        crs_from_image = aim.grid.crs_from_grid
        height, width = aim.coverage.shape
        x = crs_from_image[0, 0] * (np.arange(width) + 0.5) + crs_from_image[0, 2]
        y = crs_from_image[1, 1] * (np.arange(height) + 0.5) + crs_from_image[1, 2]
        alpha = np.where(aim.coverage > 0, np.uint8(255), np.uint8(0))
        values = np.moveaxis(np.dstack([aim.image, alpha]), -1, 0)
        coordinates = {"band": ["red", "green", "blue", "alpha"], "y": y, "x": x}
        array = DataArray(values, coordinates, ("band", "y", "x"), name="aim")
        array = array.rio.write_transform(Affine(*crs_from_image[:2].flat))
        return array if aim.world.crs is None else array.rio.write_crs(aim.world.crs)

    @classmethod
    def from_image(
        cls,
        image: UInt8[Array, "H W 3"],
        world_from_image: Float[Array, "3 3"],
        world: World,
        source: str,
    ) -> "AIM":
        """Make an AIM from one image: each pixel was seen in one frame, and none is contested.

        Args:
            image: (H, W, 3) RGB.
            world_from_image: (3, 3) pixels to world metres.
            world: the plane that those metres lie in.
            source: where the image comes from, such as a file's name; the only entry of the report.

        Returns:
            The AIM.
        """
        size = np.shape(image)[:2]
        coverage, contested = np.ones(size, np.uint16), np.zeros(size, bool)
        return cls(image, world_from_image, world, coverage, contested, {"source": source})

    @property
    def grid(self) -> Grid:
        """The grid of the image's pixels in the world."""
        return Grid(self.coverage.shape, self.world_from_image, self.world)

    @property
    def corners(self) -> Float[Array, "4 2"]:
        """(4, 2) world coordinates (m) of the image's corners.

        Top-left, top-right, bottom-right, bottom-left.
        """
        return self.grid.corners

    @property
    def resolution(self) -> float:
        """Metres per pixel at the image centre."""
        return self.grid.resolution

    @property
    def is_affine(self) -> bool:
        """Whether the transform is free of perspective, as a GeoTIFF or a texture needs."""
        return bool(np.array_equal(self.world_from_image[2], [0.0, 0.0, 1.0]))

    def summarize(self) -> dict[str, str]:
        """Summarize the map's size, its world, how it was made and how accurate it is."""
        height, width = self.image.shape[:2]
        edges = np.roll(self.corners, -1, axis=0) - self.corners
        across, down = np.linalg.norm(edges, axis=1).reshape(2, 2).mean(axis=0)
        size = f"{width} x {height} px, {across:.0f} x {down:.0f} m"
        lines = {"image": size, "world": describe_world(self.world)}
        return lines | summarize_report(self.report)

    def _draw(self, axes: "Axes") -> None:
        from geoaim.base.map_axes import draw_image

        draw_image(axes, self.image, self.grid, self.coverage > 0)


def _check_array(name: str, value: Any, dtype: type, shape: tuple[int, ...]) -> None:
    if getattr(value, "dtype", None) != dtype or value.shape != shape:
        actual = f"{value.dtype} {value.shape}" if hasattr(value, "dtype") else type(value).__name__
        raise ValueError(f"{name} must be {np.dtype(dtype)} {shape}, found {actual}")


def _check_transform(world_from_image: Float[Array, "3 3"], height: int, width: int) -> None:
    if not np.isfinite(world_from_image).all() or np.linalg.det(world_from_image) == 0:
        raise ValueError(f"world_from_image must be finite and invertible:\n{world_from_image}")
    depth = image_corners(height, width) @ world_from_image[2, :2] + world_from_image[2, 2]
    if not ((depth > 0).all() or (depth < 0).all()):
        raise AimError(
            "the image reaches past the horizon: its corners have depths "
            f"{np.round(depth, 3).tolist()} of both signs; crop it to the ground, or give control "
            "points that are spread over the whole image"
        )
    farthest = np.abs(transform_points(world_from_image, image_corners(height, width))).max()
    if not farthest <= MAX_POSITION_M:
        raise AimError(
            f"a corner of the image lies {farthest:g} m from the world's origin, off the Earth; "
            "the matrix from pixels to metres is wrong"
        )
