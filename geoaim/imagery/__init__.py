"""Rasters and tiles of others: read as mosaics, and aligned to tracks or to an AIM."""
