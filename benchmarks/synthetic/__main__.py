"""Run the benchmark: python -m benchmarks.synthetic --help."""

import typer

from benchmarks.synthetic.benchmark import main

if __name__ == "__main__":
    typer.run(main)
