"""Run the benchmark: python -m benchmarks.alignment --help."""

import typer

from benchmarks.alignment.benchmark import main

typer.run(main)
