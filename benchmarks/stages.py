"""Run the benchmark of a mapping stage from the command line: tables and charts in a folder."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.results import Results, write_results
from geoaim.base.files import check_writable
from geoaim.base.progress import Progress
from geoaim.cli.console import report_errors, show_progress

Measure = Callable[[bool, Progress], Results]  # takes whether to be quick, and the progress


def make_main(stage: str, measure: Measure) -> Callable[..., None]:
    """Make the command of a stage.

    Args:
        stage: the last part of the module's name, and the name of the files.
        measure: measures the stage.

    Returns:
        A function that typer runs.
    """

    def main(
        output: Annotated[Path, typer.Option("--output", "-o", help="folder to write to")] = Path(
            "bench"
        ),
        quick: Annotated[bool, typer.Option("--quick", help="a minute: few small cases")] = False,
    ) -> None:
        """Write tables as JSON and Markdown, and charts."""
        with show_progress() as progress, report_errors():
            name = stage.rpartition(".")[2]
            check_writable(output / f"{name}.json")
            command = f"python -m benchmarks.{stage}{' --quick' * quick}"
            paths = write_results(measure(quick, progress), output, name, command)
        print(", ".join(map(str, paths)))

    return main
