"""Run the benchmark: python -m benchmarks.catalog --help."""

import typer

from benchmarks.catalog.benchmark import main

if __name__ == "__main__":
    typer.run(main)
