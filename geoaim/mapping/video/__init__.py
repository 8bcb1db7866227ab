"""Video: frames with their times, telemetry and detections."""
