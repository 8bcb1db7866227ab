"""Run the benchmark: python -m benchmarks.realism --help."""

import typer

from benchmarks.realism.benchmark import main

if __name__ == "__main__":
    typer.run(main)
