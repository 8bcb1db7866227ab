"""Run the benchmark: python -m benchmarks.synthetic --help."""

import typer

from benchmarks.synthetic.benchmark import main

typer.run(main)
