"""The region that imagery is wanted for: its points in any CRS, and how finely rasters show it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import GeoreferenceError, ImageryError
from geoaim.geometry import transform_points
from geoaim.imagery.rasters import Raster
from geoaim.world import LONLAT, World, choose_world, crs_from_world, transform_crs, world_from_crs

MAX_EXTENT_DEGREES = 6.0  # of longitude or latitude, read without a region: a UTM zone is as wide

Outline = tuple[str, Float[Array, "m 2"]]  # a CRS, and points along an outline in it


@dataclass(frozen=True, eq=False)
class Region:
    """The region that imagery is wanted for.

    Attributes:
        world: plane of the wanted image.
        points: (M, 2) points spread over the region, world metres.
    """

    world: World
    points: Float[Array, "m 2"]

    def to_crs(self, crs: str) -> Float[Array, "m 2"]:
        """The points in a CRS, x first."""
        return crs_from_world(self.world, self.points, crs)


def make_region(world: World, corners: Float[Array, "n 2"]) -> Region:
    """The region within the bounds of points in world metres."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    shares = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9)), axis=-1)
    return Region(world, low + (high - low) * shares.reshape(-1, 2))


def enclose_outlines(outlines: Sequence[Outline], world: World | None) -> Region:
    """The region around outlines, in a world of their own when None is given.

    Raises:
        ImageryError: the outlines extend over more than one image can show.
    """
    lonlat = np.concatenate([transform_crs(crs, LONLAT, points) for crs, points in outlines])
    spans = np.ptp(lonlat, axis=0)
    if spans.max() > MAX_EXTENT_DEGREES:
        raise ImageryError(
            f"the imagery spans {spans[0]:.3g} by {spans[1]:.3g} degrees (longitude, latitude), "
            f"and at most {MAX_EXTENT_DEGREES:g} are read as a whole: name a world and corners"
        )
    world = world or choose_world(lonlat)
    corners = np.concatenate([world_from_crs(world, points, crs) for crs, points in outlines])
    return make_region(world, corners)


def describe_extent(outlines: Sequence[Outline]) -> str:
    """Longitudes and latitudes of outlines, for a message."""
    try:
        lonlat = np.concatenate([transform_crs(crs, LONLAT, points) for crs, points in outlines])
    except GeoreferenceError as error:
        return f"a place that has no longitude and latitude ({error})"
    (west, south), (east, north) = lonlat.min(axis=0), lonlat.max(axis=0)
    return f"longitude {west:.6f} to {east:.6f}, latitude {south:.6f} to {north:.6f}"


def measure_resolution(raster: Raster, region: Region) -> float:
    """Metres a pixel of a raster in the middle of a region: the root of the area of a pixel."""
    middle = (region.points.min(axis=0) + region.points.max(axis=0)) / 2.0
    cross = middle + 5.0 * np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
    points = Region(region.world, cross).to_crs(raster.crs)
    pixels = transform_points(raster.grid.grid_from_world, points)
    steps = (pixels[1::2] - pixels[::2]) / 10.0
    return float(1.0 / np.sqrt(abs(np.linalg.det(steps))))
