"""Defaults that commands show in their help, so that it imports no stage."""

SAMPLES = 6  # futures that a prediction samples, as in the paper
MAX_HISTORY_STEPS = 10  # observed steps that a model gets at most, as in the paper

# the largest expected error of imagery's position
MAX_SHIFT = 15.0  # metres
MAX_ROTATION_DEGREES = 5.0
MAX_SCALING = 0.05  # change of scale as a share: 0.05 is 5 %
