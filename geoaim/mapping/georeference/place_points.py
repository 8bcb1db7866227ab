"""Transform control points that were picked on any frames to pixels of the reference."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import GeoreferenceError, warn
from geoaim.geometry import transform_points
from geoaim.mapping.georeference.control_points import (
    ControlPoints,
    merge_observations,
    select_points,
)
from geoaim.mapping.georeference.photo_links import chain_links, choose_central_photo, link_photos
from geoaim.mapping.georeference.point_checks import MIN_POINTS
from geoaim.mapping.registration.register import Reference, choose_reference, register_frames
from geoaim.mapping.video.detections import Detections
from geoaim.mapping.video.video import Video

FrameName = str | int | None  # of the frame that a control point was picked on


def place_points(
    points: ControlPoints, video: Video, reference: Reference, detections: Detections | None
) -> tuple[ControlPoints, Reference]:
    """Transform control points to the reference; points that cannot be placed are left out.

    Where photos of a flight cannot all be registered to one, overlapping photos are linked, and the
    central one of those with control points becomes the reference.

    Args:
        points: picked on any frames of the video.
        video: the video.
        reference: the reference frame.
        detections: vehicles that registration leaves out.

    Returns:
        One control point for each place, in pixels of the reference, and that reference.

    Raises:
        GeoreferenceError: too few points can be placed, or a frame is missing.
    """
    frames = {picked: _find_frame_index(picked, video) for picked in points.frames}
    transforms, reasons = {}, {}
    for picked, index in frames.items():
        frame = next(iter(video.frames_at([index / video.rate])))
        [(_, placement)] = register_frames([frame], reference, detections=detections)
        if placement.valid:
            transforms[picked] = placement.reference_from_frame
        elif video.names is not None and len(frames) > 1:
            return _place_by_links(points, frames, video, detections)
        else:
            reasons[picked] = placement.reason
    return _transform_points(points, transforms, reasons, reference), reference


def _place_by_links(
    points: ControlPoints,
    frames: Mapping[FrameName, int],
    video: Video,
    detections: Detections | None,
) -> tuple[ControlPoints, Reference]:
    links = link_photos(video, detections)
    central = choose_central_photo(links, list(frames.values()))
    reference = choose_reference(video, detections=detections, time=central / video.rate)
    chained = {picked: chain_links(links, index, central) for picked, index in frames.items()}
    transforms = {picked: matrix for picked, matrix in chained.items() if matrix is not None}
    reasons = dict.fromkeys(set(chained) - set(transforms), "it overlaps with no other")
    return _transform_points(points, transforms, reasons, reference), reference


def _transform_points(
    points: ControlPoints,
    transforms: Mapping[FrameName, Float[Array, "3 3"]],
    reasons: Mapping[FrameName, str],
    reference: Reference,
) -> ControlPoints:
    """Points in pixels of the reference; those on frames without a transform are left out."""
    pixels = points.pixels.copy()
    for i, picked in enumerate(points.frames):
        if picked in transforms:
            pixels[i] = transform_points(transforms[picked], pixels[i : i + 1])[0]
    placed = [i for i, picked in enumerate(points.frames) if picked in transforms]
    left = len(np.unique(points.coordinates[placed], axis=0))
    if reasons:
        dropped = ", ".join(
            f"{name} on frame {picked or 0} ({reasons[picked]})"
            for name, picked in zip(points.names, points.frames, strict=True)
            if picked in reasons
        )
        problem = f"cannot be registered to frame {reference.index} and are left out: {dropped}"
        if left < MIN_POINTS:
            raise GeoreferenceError(
                f"control points {problem}. {left} are left, at least {MIN_POINTS} are needed:"
                " pick them on frames that overlap with others"
            )
        warn(f"control points {problem}")
    merged = merge_observations(select_points(replace(points, pixels=pixels), placed))
    return replace(merged, frames=(None,) * len(merged.pixels))


def _find_frame_index(picked: FrameName, video: Video) -> int:
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
