"""The paper's tables and more, each by one name of `geoaim experiment`."""

from geoaim.experiments import ablations, people, shipping, sind, songdo, stanford, vehicles

EXPERIMENTS = {
    "shipped": shipping.run,
    "people": people.run,
    "vehicles": vehicles.run,
    "stanford": stanford.run,
    "songdo": songdo.run,
    "sind": sind.run,
    "ablations": ablations.run,
}
