"""Run the benchmark: python -m benchmarks.rendering --help."""

import typer

from benchmarks.rendering.benchmark import main

if __name__ == "__main__":
    typer.run(main)
