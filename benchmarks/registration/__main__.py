"""Run the benchmark: python -m benchmarks.registration --help."""

import typer

from benchmarks.registration.benchmark import measure_registration
from benchmarks.stages import make_main

if __name__ == "__main__":
    typer.run(make_main("registration", measure_registration))
