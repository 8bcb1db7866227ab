"""Tracking: a video and detections in its frames -> tracks in the world, in `pipeline`'s order."""

from geoaim.tracking.pipeline import track_boxes, track_video

__all__ = ["track_boxes", "track_video"]
