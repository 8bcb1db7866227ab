"""What everything stands on: errors, files, worlds, grids, geometry, axes of maps."""
