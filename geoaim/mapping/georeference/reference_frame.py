"""Georeference the reference frame of a video, by control points on any frame or by telemetry."""

from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.place_points import place_points
from geoaim.mapping.georeference.point_checks import check_inside
from geoaim.mapping.georeference.reference_telemetry import georeference_by_telemetry
from geoaim.mapping.registration.register import Reference
from geoaim.mapping.video.detections import Detections
from geoaim.mapping.video.video import Video
from geoaim.world import LONLAT, choose_world, transform_crs


def choose_reference_time(gcps: ControlPoints | Georeference | None) -> float | None:
    """Choose the reference's time: 0.0 where `gcps` are of the first frame; None leaves it open."""
    if isinstance(gcps, ControlPoints):
        return 0.0 if all(frame in (None, 0) for frame in gcps.frames) else None
    return None if gcps is None else 0.0


def georeference_reference_frame(
    points: ControlPoints | None,
    video: Video,
    reference: Reference,
    detections: Detections | None,
    crs: str | None,
) -> tuple[Georeference, ControlPoints | None, Reference]:
    """Georeference the reference frame by control points, or without them by telemetry.

    Args:
        points: picked on any frames of the video.
        video: with its telemetry.
        reference: the reference frame.
        detections: vehicles that registration leaves out.
        crs: of the world, projected and in metres; None keeps the points' own, or their UTM zone.

    Returns:
        The georeference; one control point for each place, with pixels of the reference frame; and
        the reference, which is another one where `place_points` needs it.

    Raises:
        GeoreferenceError: nothing fixes a place, or a frame with control points is missing.
    """
    if points is None:
        return georeference_by_telemetry(video, reference), None, reference
    check_inside(points, (video.height, video.width))
    points, reference = place_points(points, video, reference, detections)
    world = None
    if crs is not None and points.crs is not None:
        world = choose_world(transform_crs(points.crs, LONLAT, points.coordinates), crs=crs)
    height, width = reference.height, reference.width
    georeference = estimate_georeference(
        points, height=height, width=width, world=world, outside=True
    )
    return georeference, points, reference
