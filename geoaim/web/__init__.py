"""Exploring maps and picking control points: in a browser page, in Jupyter, or in one HTML file."""
