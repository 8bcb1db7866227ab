"""Vehicles in single frames: a small network, the scale of a video by their sizes, their files."""

from geoaim.detection.detect import Found, detect, write_detections
from geoaim.detection.scale import Scale, propose_scale
from geoaim.detection.vehicles import detect_vehicles

__all__ = ["Found", "Scale", "detect", "detect_vehicles", "propose_scale", "write_detections"]
