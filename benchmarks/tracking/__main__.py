"""Run the benchmark: python -m benchmarks.tracking --help."""

import typer

from benchmarks.tracking.benchmark import main

if __name__ == "__main__":
    typer.run(main)
