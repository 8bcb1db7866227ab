"""Run the benchmark: python -m benchmarks.catalog --help."""

import typer

from benchmarks.catalog.benchmark import main

typer.run(main)
