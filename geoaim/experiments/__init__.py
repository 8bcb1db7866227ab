"""The paper's tables and more, each by one name of `geoaim experiment`."""

from geoaim.experiments import ablations, shipping, sind, songdo, stanford, synthetic

EXPERIMENTS = {
    "shipped": shipping.run,
    "synthetic": synthetic.run,
    "stanford": stanford.run,
    "songdo": songdo.run,
    "sind": sind.run,
    "ablations": ablations.run,
}
