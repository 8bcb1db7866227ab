"""Run the benchmark: python -m benchmarks.rendering --help."""

import typer

from benchmarks.rendering.benchmark import main

typer.run(main)
