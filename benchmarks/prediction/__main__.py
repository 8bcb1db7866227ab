"""Repeat the experiments of prediction: the paper's tables and public data sets."""

from pathlib import Path
from typing import Annotated

import typer

from geoaim.cli.console import console, report_errors, show_progress


def experiment(
    name: Annotated[str, typer.Argument(help="name of the experiment; 'list' prints all")],
    folder: Annotated[
        Path, typer.Option("--folder", help="folder for generated places and trained models")
    ] = Path("build/experiments"),
    output: Annotated[
        Path, typer.Option("--output", "-o", help="folder for tables and figures")
    ] = Path("docs/experiments"),
) -> None:
    """Repeat an experiment: generate places or read real data, train models, write tables.

    What exists in the folder is used again, so that an interrupted experiment resumes. Real data
    are read from the folder that the environment variable GEOAIM_DATA names.

    Example: python -m benchmarks.prediction list
    """
    from benchmarks.prediction import EXPERIMENTS
    from benchmarks.prediction.results import Workspace
    from geoaim.base.files import check_writable

    with show_progress() as progress, report_errors():
        if name == "list":
            for key, run in EXPERIMENTS.items():
                console.print(f"{key}: {run.__doc__}")
            return
        if name not in EXPERIMENTS:
            raise ValueError(f"there is no experiment {name!r}; 'list' prints all names")
        check_writable(output / name)
        written = EXPERIMENTS[name](Workspace(folder, output, progress))
    console.print(", ".join(str(path) for path in written))


if __name__ == "__main__":
    typer.run(experiment)
