"""Agents over time: tracks, traffic lights, their tables, files and formats."""
