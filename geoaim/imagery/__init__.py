"""Third-party rasters and tiles: read as mosaics, and aligned to tracks or to an AIM."""
