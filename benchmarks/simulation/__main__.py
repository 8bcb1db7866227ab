"""Run the benchmark: python -m benchmarks.simulation --help."""

import typer

from benchmarks.simulation.benchmark import main

if __name__ == "__main__":
    typer.run(main)
