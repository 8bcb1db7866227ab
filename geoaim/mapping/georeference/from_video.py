"""Where the reference frame lies: by control points on any frame, telemetry, or as given."""

from dataclasses import replace
from typing import Any

import numpy as np

from geoaim.errors import GeoreferenceError
from geoaim.geometry import transform_points
from geoaim.mapping.georeference.control_points import ControlPoints, merge_observations
from geoaim.mapping.georeference.estimate import Georeference, georeference
from geoaim.mapping.georeference.from_telemetry import approximate_georeference
from geoaim.mapping.registration.register import Reference, register_frames
from geoaim.mapping.video.detections import Detections
from geoaim.mapping.video.video import Video
from geoaim.world import choose_world, transform_crs

STEEP = np.radians(10.0)  # of a camera's axis from straight down, placed by telemetry


def reference_time(points: ControlPoints | None, gcps: Any) -> float | None:
    """The first frame where something is known of it, so that its pixels are the map's."""
    on_first = points is not None and all(frame in (None, 0) for frame in points.frames)
    return 0.0 if on_first or isinstance(gcps, Georeference) else None


def find_place(
    points: ControlPoints | None, video: Video, reference: Reference, crs: str | None
) -> Georeference:
    """By control points on the reference, into `crs` when given; without them by telemetry."""
    size = {"height": reference.height, "width": reference.width}
    if points is None:
        return _place_by_telemetry(video, reference)
    world = None
    if crs is not None and points.crs is not None:
        world = choose_world(transform_crs(points.crs, "EPSG:4326", points.coordinates), crs=crs)
    return georeference(points, world=world, **size)


def points_on_reference(
    points: ControlPoints, video: Video, reference: Reference, detections: Detections | None
) -> ControlPoints:
    """Control points moved from the frames that they were picked on to the reference."""
    pixels = points.pixels.copy()
    for picked in dict.fromkeys(points.frames):
        index = _frame_index(picked, video)
        frame = next(iter(video.frames_at([index / video.rate])))
        [(_, placement)] = register_frames([frame], reference, detections=detections)
        mine = np.array([other == picked for other in points.frames])
        if not placement.valid:
            names = ", ".join(np.array(points.names)[mine])
            raise GeoreferenceError(
                f"{names}: picked on frame {index}, which cannot be laid on the reference at "
                f"{reference.time:.2f} s ({placement.reason}); pick them on another frame"
            )
        pixels[mine] = transform_points(placement.matrix, points.pixels[mine])
    merged = merge_observations(replace(points, pixels=pixels))
    return replace(merged, frames=(None,) * len(merged.pixels))


def _frame_index(picked: str | int | None, video: Video) -> int:
    if picked is None or isinstance(picked, int):
        if picked and video.frame_count is not None and picked >= video.frame_count:
            raise GeoreferenceError(
                f"control points name frame {picked}, but {video.source} has {video.frame_count} "
                "frames, counted from 0"
            )
        return picked or 0
    if video.names is None or picked not in video.names:
        raise GeoreferenceError(
            f"control points name the frame {picked!r}, which is not among those of "
            f"{video.source}; use the file's name, or a frame's number for a video"
        )
    return video.names.index(picked)


def _place_by_telemetry(video: Video, reference: Reference) -> Georeference:
    state = video.telemetry
    if state is None:
        raise GeoreferenceError(
            f"{video.source}: no control points were given and no telemetry lies beside it (a DJI "
            ".SRT of the same name, or GPS in the images' EXIF); give four or more control points, "
            "or a pixel size for a map that is only local"
        )
    now = int(np.argmin(np.abs(state.time - reference.time)))
    if abs(state.pitch[now] + np.pi / 2) > STEEP:
        raise GeoreferenceError(
            f"{video.source}: by its telemetry the camera looks "
            f"{-np.degrees(state.pitch[now]):.0f} degrees down; without control points only "
            "one that looks straight down (90) can be placed: give four or more"
        )
    diagonal = np.hypot(reference.height, reference.width)
    # The 35 mm equivalent refers to the diagonal of that film, 43.27 mm.
    half = 43.27 / 2 * reference.width / diagonal / state.focal_length[now]
    return approximate_georeference(
        latitude=float(state.latitude[now]),
        longitude=float(state.longitude[now]),
        height_above_ground=float(state.height[now]),
        yaw=float(state.yaw[now]),
        field_of_view=float(2 * np.arctan(half)),
        size=(reference.height, reference.width),
    )
