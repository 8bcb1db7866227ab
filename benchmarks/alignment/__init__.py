"""Alignment of imagery to maps and tracks, on synthetic and real pairs."""
