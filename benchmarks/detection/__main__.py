"""Detection of vehicles in single frames: train the network that is shipped, and judge it.

python -m benchmarks.detection train -o build/experiments/detection
python -m benchmarks.detection evaluate --json docs/bench/detection.json --charts docs/bench
"""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, help=__doc__, pretty_exceptions_enable=False)
Folder = Annotated[Path, typer.Option("--output", "-o", help="folder of the trained networks")]
FOLDER = Path("build/experiments/detection")


@app.command()
def train(output: Folder = FOLDER, seed: int = 0) -> None:
    """Train on drawn pictures, then with stills as well; about half an hour of one core."""
    from benchmarks.detection.training import train_all
    from geoaim.cli.console import report_errors

    with report_errors():
        train_all(output, seed)


@app.command()
def evaluate(
    output: Folder = FOLDER,
    json: Annotated[Path | None, typer.Option(help="JSON file to write")] = None,
    charts: Annotated[Path | None, typer.Option(help="folder for the charts")] = None,
) -> None:
    """Judge the shipped network, and the one of drawings alone if it was trained."""
    from benchmarks.detection.measure import measure_detection
    from benchmarks.results import describe_machine, write_json

    results = measure_detection(output / "drawn.onnx")
    for name, rows in results.tables.items():
        typer.echo(name)
        for row in rows:
            typer.echo("  " + ", ".join(f"{key} {value}" for key, value in row.items()))
    if json is not None:
        command = "python -m benchmarks.detection evaluate"
        write_json({"command": command, "machine": describe_machine(), **results.tables}, json)
    for name, figure in results.charts.items():
        if charts is not None:
            suffix = "jpg" if name == "detection-failures" else "png"
            figure.savefig(charts / f"{name}.{suffix}", dpi=100)


if __name__ == "__main__":
    app()
