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

__all__ = [
    "Clip",
    "Hover",
    "Traffic",
    "clean_frame",
    "film",
    "frame_boxes",
    "hover_frames",
    "reference_from_frames",
    "render_frame",
    "traffic_share",
]
