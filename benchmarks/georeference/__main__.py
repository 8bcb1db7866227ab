"""Run the benchmark: python -m benchmarks.georeference --help."""

import typer

from benchmarks.georeference.benchmark import measure_georeference
from benchmarks.stages import make_main

if __name__ == "__main__":
    typer.run(make_main("georeference", measure_georeference))
