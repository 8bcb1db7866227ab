"""Georeference of a single picture, such as a scan or a screenshot, by control points."""

from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Bool, UInt8
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.errors import ImageryError, VideoError
from geoaim.base.geometry import translation
from geoaim.base.world import World
from geoaim.imagery.rasters import describe_raster
from geoaim.imagery.resampling import MIN_ALPHA, estimate_stretch, resample_raster, unpremultiply
from geoaim.mapping.georeference.control_points import ControlPointSource, read_control_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.point_checks import warn_of_small_part
from geoaim.mapping.report import report_georeference, report_position
from geoaim.mapping.video.video import open_video

STRIP_ROWS = 2048  # rows that are read at a time
MASKED_SUFFIXES = {".png", ".tif", ".tiff"}  # may have masks; other pictures are turned upright


def georeference_picture(
    path: Path,
    gcps: ControlPointSource,
    *,
    world: World | None = None,
    crs: str | None = None,
    similarity: bool = False,
) -> AIM:
    """Georeference a picture by control points."""
    points = read_control_points(gcps, crs=crs)
    image, valid = _read_picture(path)
    height, width = valid.shape
    warn_of_small_part(points, (height, width))
    place = estimate_georeference(
        points, height=height, width=width, world=world, similarity=similarity
    )
    return AIM(
        image=image,
        world_from_image=place.world_from_image,
        world=place.world,
        coverage=valid.astype(np.uint16),
        contested=np.zeros((height, width), bool),
        report={
            "source": str(path),
            "georeference": report_georeference(place, points),
            "position": report_position(place, points),
        },
    )


def _read_picture(path: Path) -> tuple[UInt8[Array, "H W 3"], Bool[Array, "H W"]]:
    """A picture, and where it is not masked."""
    if path.is_file() and path.suffix.lower() in MASKED_SUFFIXES:
        return _read_masked_picture(path)
    if path.is_dir():
        raise ImageryError(f"{path} is a folder; control points refer to one picture: give that")
    try:
        image, *others = [frame.image for frame in islice(open_video(str(path)), 2)]
    except VideoError as error:
        raise ImageryError(str(error)) from error
    if others:
        raise ImageryError(f"{path} has several images; control points refer to one: give one")
    return image, np.ones(image.shape[:2], bool)


def _read_masked_picture(path: Path) -> tuple[UInt8[Array, "H W 3"], Bool[Array, "H W"]]:
    """A picture without what nodata, masks and alpha hide; more than 8 bits are stretched."""
    raster = describe_raster(str(path), georeference=("pixels", np.eye(3)))
    stretch = estimate_stretch([raster], {"pixels": np.array([[0.0, 0.0], [1.0, 1.0]])})
    image = np.zeros((*raster.grid.shape, 3), np.uint8)
    valid = np.zeros(raster.grid.shape, bool)
    for top in range(0, raster.grid.height, STRIP_ROWS):
        strip = image[top : top + STRIP_ROWS]
        resampled = resample_raster(raster, translation(0, top), strip.shape[:2], stretch)
        if resampled is not None:
            strip[:] = unpremultiply(resampled[2])
            valid[top : top + STRIP_ROWS] = resampled[2][3] >= MIN_ALPHA
    if not valid.any():
        raise ImageryError(f"{path} shows nothing but nodata or transparency; give another picture")
    return image, valid
