"""Made places with truth for everything: roads, traffic, lights, HD map, drone video, imagery.

sample = make_sample(1, kind="roundabout")
write_sample(sample, Path("sample"))
"""

from geoaim.encode import write_video
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
from geoaim.synthetic.files import write_sample
from geoaim.synthetic.place import Place, draw_place, make_place, world_from_image
from geoaim.synthetic.sample import VIDEOS, Sample, make_sample, tracks_of
from geoaim.synthetic.scenery.day import Day

__all__ = [
    "VIDEOS",
    "Clip",
    "Day",
    "Hover",
    "Place",
    "Sample",
    "Traffic",
    "clean_frame",
    "draw_place",
    "film",
    "frame_boxes",
    "hover_frames",
    "make_place",
    "make_sample",
    "reference_from_frames",
    "render_frame",
    "tracks_of",
    "traffic_share",
    "world_from_image",
    "write_sample",
    "write_video",
]
