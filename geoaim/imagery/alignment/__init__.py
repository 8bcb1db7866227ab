"""Correction of the position of imagery by control points, an AIM, or tracks."""
