"""The paper's tables and public benchmarks, by their names in `python -m benchmarks.prediction`."""

from benchmarks.prediction import (
    observed_states,
    pedestrians,
    pretrained,
    sind,
    songdo,
    stanford,
    vehicles,
    zero_shot,
)

EXPERIMENTS = {
    "pretrained": pretrained.run,
    "pedestrians": pedestrians.run,
    "vehicles": vehicles.run,
    "stanford": stanford.run,
    "songdo": songdo.run,
    "sind": sind.run,
    "zero_shot": zero_shot.run,
    "observed_states": observed_states.run,
}
