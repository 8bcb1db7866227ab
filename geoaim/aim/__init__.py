"""The map: an image of the ground with its place, its files, summary and pictures."""
