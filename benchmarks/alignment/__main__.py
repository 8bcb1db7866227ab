"""Run the benchmark: python -m benchmarks.alignment --help."""

import typer

from benchmarks.alignment.benchmark import main

if __name__ == "__main__":
    typer.run(main)
