"""Simulated traffic of a place: signals, vehicles on fixed paths, pedestrians, recordings."""
