"""The paper's tables and more, each by one name of `geoaim experiment`."""

from geoaim.experiments.songdo import songdo
from geoaim.experiments.stanford import stanford
from geoaim.experiments.synthetic import synthetic

EXPERIMENTS = {run.__name__: run for run in (synthetic, stanford, songdo)}
