"""From video to AIM: registration, background and georeference, in the order of `pipeline`."""

from geoaim.base.geometry import transform_boxes, transform_points
from geoaim.mapping.background.running_mean import average_frames
from geoaim.mapping.background.traffic_search import remove_traffic
from geoaim.mapping.georeference.control_points import read_control_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.place_tracks import place_tracks
from geoaim.mapping.pipeline import build_aim
from geoaim.mapping.registration.register import register, write_registration
from geoaim.mapping.texture import export_texture
from geoaim.mapping.video.detections import read_detections
from geoaim.mapping.video.video import open_video

__all__ = [
    "average_frames",
    "build_aim",
    "estimate_georeference",
    "export_texture",
    "open_video",
    "place_tracks",
    "read_control_points",
    "read_detections",
    "register",
    "remove_traffic",
    "transform_boxes",
    "transform_points",
    "write_registration",
]
