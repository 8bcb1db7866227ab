"""Simulated traffic of a made place: signals, vehicles on fixed paths, pedestrians, recordings."""
