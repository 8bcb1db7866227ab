"""Frames with their times, telemetry and detections."""
