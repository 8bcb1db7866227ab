"""Made scenes with exact truth: a hovering camera over any still or drawn junction."""

from geoaim.synthetic.camera import (
    Clip,
    Hover,
    Traffic,
    clean_frame,
    film,
    frame_boxes,
    hover_frames,
    reference_from_frames,
    render_frame,
    traffic_share,
)
from geoaim.synthetic.drawing import Junction, draw_junction
from geoaim.synthetic.driving import drive_junction
from geoaim.synthetic.sample import make_sample, write_sample, write_scene, write_video

__all__ = [
    "Clip",
    "Hover",
    "Junction",
    "Traffic",
    "clean_frame",
    "draw_junction",
    "drive_junction",
    "film",
    "frame_boxes",
    "hover_frames",
    "make_sample",
    "reference_from_frames",
    "render_frame",
    "traffic_share",
    "write_sample",
    "write_scene",
    "write_video",
]
