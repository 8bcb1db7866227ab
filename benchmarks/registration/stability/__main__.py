"""Run the benchmark: python -m benchmarks.registration.stability --help."""

import typer

from benchmarks.registration.stability.benchmark import measure_stability
from benchmarks.stages import make_main

if __name__ == "__main__":
    typer.run(make_main("registration.stability", measure_stability))
