"""Georeference the reference frame of a video, by control points on any frame or by telemetry."""

from dataclasses import replace

import numpy as np

from geoaim.errors import GeoreferenceError
from geoaim.geometry import transform_points
from geoaim.mapping.georeference.control_points import ControlPoints, merge_observations
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.reference_telemetry import georeference_by_telemetry
from geoaim.mapping.registration.register import Reference, register_frames
from geoaim.mapping.video.detections import Detections
from geoaim.mapping.video.video import Video
from geoaim.world import LONLAT, choose_world, transform_crs


def choose_reference_time(gcps: ControlPoints | Georeference | None) -> float | None:
    """Choose the first frame, at 0 s, where `gcps` refer to its pixels; else None, any frame."""
    if isinstance(gcps, ControlPoints):
        return 0.0 if all(frame in (None, 0) for frame in gcps.frames) else None
    return None if gcps is None else 0.0


def georeference_reference_frame(
    points: ControlPoints | None,
    video: Video,
    reference: Reference,
    detections: Detections | None,
    crs: str | None,
) -> tuple[Georeference, ControlPoints | None]:
    """Georeference the reference frame by control points, or without them by telemetry.

    Args:
        points: picked on any frames of the video.
        video: with its telemetry.
        reference: the reference frame.
        detections: vehicles that registration leaves out.
        crs: of the world, projected and in metres; None keeps the points' own, or their UTM zone.

    Returns:
        The georeference, and one control point for each place, with pixels of the reference frame.

    Raises:
        GeoreferenceError: nothing fixes a place, or a frame with control points is missing.
    """
    if points is None:
        return georeference_by_telemetry(video, reference), None
    points = _transform_points_to_reference(points, video, reference, detections)
    world = None
    if crs is not None and points.crs is not None:
        world = choose_world(transform_crs(points.crs, LONLAT, points.coordinates), crs=crs)
    height, width = reference.height, reference.width
    return estimate_georeference(points, height=height, width=width, world=world), points


def _transform_points_to_reference(
    points: ControlPoints, video: Video, reference: Reference, detections: Detections | None
) -> ControlPoints:
    pixels = points.pixels.copy()
    for picked in dict.fromkeys(points.frames):
        index = _find_frame_index(picked, video)
        frame = next(iter(video.frames_at([index / video.rate])))
        [(_, placement)] = register_frames([frame], reference, detections=detections)
        on_frame = np.array([other == picked for other in points.frames])
        if not placement.valid:
            names = ", ".join(np.array(points.names)[on_frame])
            raise GeoreferenceError(
                f"{names}: picked on frame {index}, which cannot be registered to the reference at "
                f"{reference.time:.2f} s ({placement.reason}); pick them on another frame"
            )
        pixels[on_frame] = transform_points(placement.reference_from_frame, points.pixels[on_frame])
    merged = merge_observations(replace(points, pixels=pixels))
    return replace(merged, frames=(None,) * len(merged.pixels))


def _find_frame_index(picked: str | int | None, video: Video) -> int:
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
