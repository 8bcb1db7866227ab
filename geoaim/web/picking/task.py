"""The task of picking: a frame, imagery, and the file of the points."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.position import read_position_covariance
from geoaim.base.world import LONLAT
from geoaim.imagery.mosaic import read_imagery
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.reference_frame import FrameName
from geoaim.mapping.video.video import open_video, read_frame


@dataclass(frozen=True, eq=False)
class PickingTask:
    """What control points are picked on."""

    frame: UInt8[Array, "H W 3"]
    frame_name: FrameName = None  # the frame of a video; None: its first one, or a single picture
    # imagery on which the same places are picked; None: coordinates are typed
    imagery: AIM | None = None
    crs: str | None = LONLAT  # CRS of the coordinates; None for a local metric plane
    path: Path | None = None  # the .csv that is written after each change
    # rough georeference of the frame, as by telemetry, in the imagery's world
    rough: Georeference | None = None

    @property
    def accuracy(self) -> float:
        """One sigma of the places, metres: a pixel of the imagery they are picked on."""
        return 0.0 if self.imagery is None else self.imagery.resolution

    @property
    def shared_covariance(self) -> Float[Array, "2 2"] | None:
        """Covariance of the imagery's own place, square metres, which all points share."""
        return None if self.imagery is None else read_position_covariance(self.imagery.report)


def read_task(
    video: str | Path,
    path: str | os.PathLike[str],
    *,
    imagery: AIM | str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | None = None,
    time: float = 0.0,
    crs: str | None = LONLAT,
    imagery_crs: str | None = None,
) -> PickingTask:
    """Read the frame and the imagery on which control points are picked.

    Args:
        video: a video, images or one image.
        path: the .csv of the points; if it exists, picking continues with its points.
        imagery: an AIM, or what `read_imagery` reads; None: coordinates are typed.
        time: time of the frame, s.
        crs: CRS of the coordinates; None for a local metric plane.
        imagery_crs: CRS of imagery that states none, such as an image with a world file.

    Returns:
        The task.

    Raises:
        GeoaimError: something cannot be read.
    """
    frame = read_frame(open_video(video), time)
    if imagery is not None and not isinstance(imagery, AIM):
        imagery = read_imagery(imagery, crs=imagery_crs)
    return PickingTask(
        frame=frame.image,
        frame_name=frame.name or frame.index or None,
        imagery=imagery,
        crs=crs,
        path=Path(path),
    )
