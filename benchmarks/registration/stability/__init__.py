"""Stability of the registration: a sweep over kinds of disturbance, with exact truth."""
