"""The command line: each command reads files, calls the library and writes files."""

from typing import Annotated

import typer

from geoaim.cli.align import align
from geoaim.cli.build import build
from geoaim.cli.console import DEBUG
from geoaim.cli.evaluate import evaluate
from geoaim.cli.experiment import experiment
from geoaim.cli.maps import draw, info, texture
from geoaim.cli.predict import predict
from geoaim.cli.register import register
from geoaim.cli.sample import sample
from geoaim.cli.simulate import render, simulate
from geoaim.cli.train import train

COMMANDS = (
    *(build, align, draw, register, info, texture, render, simulate),
    *(predict, evaluate, train, experiment, sample),
)

app = typer.Typer(name="geoaim", no_args_is_help=True, pretty_exceptions_enable=False)


@app.callback()
def set_debug(
    debug: Annotated[bool, typer.Option("--debug", help="show where an error comes from")] = False,
) -> None:
    """Aerial image-based maps (AIM) from drone video: build, render, simulate, predict."""
    DEBUG.set(debug)


for command in COMMANDS:
    app.command()(command)
