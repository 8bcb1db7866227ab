"""Synthetic places with ground truth: roads, traffic, lights, HD map, drone video, imagery.

sample = make_sample(1, kind="roundabout")
write_sample(sample, Path("sample"))
"""

from benchmarks.synthetic.camera import (
    Hover,
    HoverClip,
    SpriteTracks,
    film,
    list_boxes,
    measure_traffic_share,
    reference_from_frames,
    render_background,
    render_frame,
    render_frames,
)
from benchmarks.synthetic.files import write_sample
from benchmarks.synthetic.place import Place, draw_place, make_place, world_from_image
from benchmarks.synthetic.sample import VIDEOS, Sample, make_sample, tracks_of
from benchmarks.synthetic.scenery.day import Day
from geoaim.base.encode import write_video

__all__ = [
    "VIDEOS",
    "Day",
    "Hover",
    "HoverClip",
    "Place",
    "Sample",
    "SpriteTracks",
    "draw_place",
    "film",
    "list_boxes",
    "make_place",
    "make_sample",
    "measure_traffic_share",
    "reference_from_frames",
    "render_background",
    "render_frame",
    "render_frames",
    "tracks_of",
    "world_from_image",
    "write_sample",
    "write_video",
]
