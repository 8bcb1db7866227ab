"""Run the benchmark: python -m benchmarks.background --help."""

import typer

from benchmarks.background.benchmark import measure_backgrounds
from benchmarks.stages import make_main

if __name__ == "__main__":
    typer.run(make_main("background", measure_backgrounds))
