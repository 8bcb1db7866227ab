"""The renderer's time and memory against other renderers."""
