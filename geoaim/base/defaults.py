"""Defaults of `geoaim.prediction` that commands show in their help without importing torch."""

SAMPLES = 6  # futures that a prediction samples, as in the paper
MAX_HISTORY_STEPS = 10  # observed steps that a model gets at most, as in the paper
