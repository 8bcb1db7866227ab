"""Build a map from a video and write it with its quick look, as `geoaim build` does."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from geoaim.aim.aim import AIM
from geoaim.aim.files import write_aim
from geoaim.aim.quicklook import draw_quicklook
from geoaim.aim.rectification import rectify
from geoaim.base.files import atomic_files, write_figure
from geoaim.base.progress import Progress, no_progress
from geoaim.mapping.georeference.from_telemetry import make_local_georeference
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.reference_frame import override_telemetry
from geoaim.mapping.pipeline import build_aim
from geoaim.mapping.sampling import FrameCount
from geoaim.mapping.video.video import Video, VideoSource, open_video


@dataclass(frozen=True)
class MapSettings:
    """Options of a map, with the names and meanings of those of `geoaim build`.

    Attributes:
        frames: frames used for the background: "auto", "all" or a number.
        crs: CRS of the map, such as "EPSG:32635"; None: that of the control points.
        resolution: metres per pixel of the map; None: as in the video. Of a single image without
            control points: metres per pixel of the image.
        frame_resolution: metres per pixel of the video, for a map without control points.
        frame_origin: origin of such a map: the top-left corner or the middle of the frame.
        height: of the camera above the ground, metres, if telemetry lacks it.
        yaw: compass heading of the image's top, degrees, if telemetry lacks it.
        focal_length: of the camera, 35 mm equivalent with any zoom, millimetres, if telemetry
            lacks it.
        fixed_camera: whether the camera stands still, on a mast or a tripod.
    """

    frames: FrameCount = "auto"
    crs: str | None = None
    resolution: float | None = None
    frame_resolution: float | None = None
    frame_origin: Literal["corner", "middle"] = "corner"
    height: float | None = None
    yaw: float | None = None
    focal_length: float | None = None
    fixed_camera: bool = False


def build_map(  # noqa: PLR0913  (its options)
    video: VideoSource,
    output: Path,
    *,
    gcps: Path | None = None,
    detections: Path | None = None,
    settings: MapSettings | None = None,
    place: Callable[[AIM], AIM] | None = None,
    progress: Progress = no_progress,
) -> AIM:
    """Build a map and write it, with a quick look (.png) beside it.

    Args:
        video: what `geoaim.open_video` opens.
        output: the GeoTIFF to write.
        gcps: control points; None places the map by telemetry or by the settings.
        detections: folder of boxes of vehicles to leave out.
        settings: the options; None: the defaults.
        place: what moves the map to its place, such as by imagery; None: it stays.
        progress: called with the stage, the frames done and the frames in all.

    Returns:
        The map as it was written.

    Raises:
        ValueError: options contradict each other.
        GeoaimError: as of `geoaim.build_aim` and `geoaim.write_aim`.
    """
    settings = settings or MapSettings()
    _check_settings(settings, gcps)
    opened = override_telemetry(
        open_video(video),
        height=settings.height,
        yaw=settings.yaw,
        focal_length=settings.focal_length,
    )
    if settings.fixed_camera:
        opened = replace(opened, is_fixed=True)
    local, resolution = _make_local_georeference(opened, gcps, settings)
    aim = build_aim(
        opened,
        gcps if local is None else local,
        detections=detections,
        frames=settings.frames,
        crs=settings.crs,
        progress=progress,
    )
    if place is not None:
        aim = place(aim)
    progress("write", 0, 1)
    if resolution is not None or not aim.is_affine:
        aim = rectify(aim, resolution)
    with atomic_files(output, output.with_suffix(".png")) as (map_part, look_part):
        write_aim(aim, map_part)
        write_figure(draw_quicklook(aim), look_part)
    progress("write", 1, 1)
    return aim


def _check_settings(settings: MapSettings, gcps: Path | None) -> None:
    if settings.frame_resolution is not None and gcps is not None:
        raise ValueError("--points and --frame-resolution exclude each other; give one")
    given = settings.height, settings.yaw, settings.focal_length
    completes_telemetry = given != (None, None, None)
    if completes_telemetry and (gcps, settings.frame_resolution) != (None, None):
        raise ValueError(
            "--flying-height, --yaw and --focal-length complete telemetry, which --points and "
            "--frame-resolution replace; give one or the other"
        )


def _make_local_georeference(
    video: Video, gcps: Path | None, settings: MapSettings
) -> tuple[Georeference | None, float | None]:
    """The georeference by --frame-resolution, or None; and the resolution of the map, or None."""
    frame_resolution, resolution = settings.frame_resolution, settings.resolution
    is_still = video.names is not None and video.frame_count == 1
    if is_still and gcps is None and frame_resolution is None:
        frame_resolution, resolution = resolution, None
    if frame_resolution is None:
        return None, resolution
    height, width = video.height, video.width
    origin = (width / 2, height / 2) if settings.frame_origin == "middle" else (0.0, 0.0)
    local = make_local_georeference(
        resolution=frame_resolution, size=(height, width), origin=origin
    )
    return local, resolution
