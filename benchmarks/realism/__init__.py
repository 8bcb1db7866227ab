"""Synthetic places compared with real imagery and motion."""
