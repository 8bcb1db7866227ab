"""Georeference: where the reference frame lies in the world, by control points or telemetry."""
