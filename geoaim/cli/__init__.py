"""The command line: flags in, one call of the library, a table and files out."""

import typer

from geoaim.cli.driving import render, simulate
from geoaim.cli.learned import evaluate, experiment, predict, train
from geoaim.cli.made import sample
from geoaim.cli.maps import align, build, draw, info, register, texture

COMMANDS = (
    *(build, align, register, texture, info, draw, render, simulate),
    *(predict, evaluate, train, experiment, sample),
)

app = typer.Typer(
    name="geoaim",
    help="Aerial image-based maps (AIM) from drone video: build, draw, render, simulate, predict.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
for command in COMMANDS:
    app.command()(command)
