"""The benchmarks that `geoaim bench` runs, by the stage that they measure."""

from collections.abc import Callable

from benchmarks.background.benchmark import measure_backgrounds
from benchmarks.georeference.benchmark import measure_georeference
from benchmarks.registration.benchmark import measure_registration
from benchmarks.registration.stability.benchmark import measure_stability
from geoaim.base.progress import Progress
from geoaim.mapping.bench.report import Results

# Takes whether to be quick, and is told the progress.
BENCHMARKS: dict[str, Callable[[bool, Progress], Results]] = {
    "registration": measure_registration,
    "background": measure_backgrounds,
    "georeference": measure_georeference,
    "stability": measure_stability,
}
