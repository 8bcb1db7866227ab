"""Run the benchmark: python -m benchmarks.tracking --help."""

import typer

from benchmarks.tracking.benchmark import main

typer.run(main)
