"""Defaults that the command shares with the library, where it can read them without torch."""

SAMPLES = 6  # futures that a prediction draws, as in the paper
