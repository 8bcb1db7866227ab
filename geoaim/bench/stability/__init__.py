"""Stability of the registration: a sweep over kinds of hardship, with exact truth."""
