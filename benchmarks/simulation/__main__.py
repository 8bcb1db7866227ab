"""Run the benchmark: python -m benchmarks.simulation --help."""

import typer

from benchmarks.simulation.benchmark import main

typer.run(main)
