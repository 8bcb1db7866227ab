"""The benchmarks that `geoaim bench` runs, by the stage that they measure."""

from collections.abc import Callable

from geoaim.bench.background_results import measure_backgrounds
from geoaim.bench.georeference_results import measure_georeference
from geoaim.bench.registration import measure_registration
from geoaim.bench.report import Results
from geoaim.bench.stability.benchmark import measure_stability
from geoaim.progress import Progress

# Takes whether to be quick, and is told the progress.
BENCHMARKS: dict[str, Callable[[bool, Progress], Results]] = {
    "registration": measure_registration,
    "background": measure_backgrounds,
    "georeference": measure_georeference,
    "stability": measure_stability,
}
