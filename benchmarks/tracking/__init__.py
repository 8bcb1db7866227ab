"""Tracking in metres against trackers in pixels."""
