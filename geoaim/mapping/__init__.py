"""From video to AIM: registration, background and georeference, in the order of `pipeline`."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geoaim.base.geometry import transform_boxes as transform_boxes
    from geoaim.base.geometry import transform_points as transform_points
    from geoaim.mapping.background.running_mean import average_frames as average_frames
    from geoaim.mapping.background.traffic_search import remove_traffic as remove_traffic
    from geoaim.mapping.georeference.control_points import (
        read_control_points as read_control_points,
    )
    from geoaim.mapping.georeference.estimate import estimate_georeference as estimate_georeference
    from geoaim.mapping.georeference.pixel_tracks import place_tracks as place_tracks
    from geoaim.mapping.pipeline import build_aim as build_aim
    from geoaim.mapping.registration.register import register as register
    from geoaim.mapping.registration.register import write_registration as write_registration
    from geoaim.mapping.texture import export_texture as export_texture
    from geoaim.mapping.video.detections import DetectedBoxes as DetectedBoxes
    from geoaim.mapping.video.detections import read_detections as read_detections
    from geoaim.mapping.video.video import open_video as open_video

# the module of each public name; imported on first use, so that a build needs no pandas
_MODULE_OF_NAME = {
    "average_frames": "geoaim.mapping.background.running_mean",
    "build_aim": "geoaim.mapping.pipeline",
    "estimate_georeference": "geoaim.mapping.georeference.estimate",
    "export_texture": "geoaim.mapping.texture",
    "open_video": "geoaim.mapping.video.video",
    "place_tracks": "geoaim.mapping.georeference.pixel_tracks",
    "read_control_points": "geoaim.mapping.georeference.control_points",
    "DetectedBoxes": "geoaim.mapping.video.detections",
    "read_detections": "geoaim.mapping.video.detections",
    "register": "geoaim.mapping.registration.register",
    "remove_traffic": "geoaim.mapping.background.traffic_search",
    "transform_boxes": "geoaim.base.geometry",
    "transform_points": "geoaim.base.geometry",
    "write_registration": "geoaim.mapping.registration.register",
}
__all__ = list(_MODULE_OF_NAME)


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF_NAME:
        return getattr(import_module(_MODULE_OF_NAME[name]), name)
    raise AttributeError(f"module 'geoaim.mapping' has no attribute {name!r}")
