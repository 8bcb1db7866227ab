"""The paper's tables and public benchmarks, each by its name in `geoaim experiment`."""

from geoaim.experiments import pedestrians, pretrained, sind, songdo, stanford, vehicles

EXPERIMENTS = {
    "pretrained": pretrained.run,
    "pedestrians": pedestrians.run,
    "vehicles": vehicles.run,
    "stanford": stanford.run,
    "songdo": songdo.run,
    "sind": sind.run,
}
