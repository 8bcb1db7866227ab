"""The command line: each command reads files, calls the library and writes files."""

import sys
from typing import Annotated

import typer

from geoaim import __version__
from geoaim.cli.align import align
from geoaim.cli.bench import bench
from geoaim.cli.build import build
from geoaim.cli.catalog import app as catalog
from geoaim.cli.console import DEBUG, stop_when_terminated
from geoaim.cli.convert import convert
from geoaim.cli.doctor import doctor
from geoaim.cli.evaluate import evaluate
from geoaim.cli.frame import frame
from geoaim.cli.info import info
from geoaim.cli.maps import draw, texture
from geoaim.cli.pick import pick
from geoaim.cli.predict import predict
from geoaim.cli.register import register
from geoaim.cli.sample import sample
from geoaim.cli.simulate import render, simulate
from geoaim.cli.track import track
from geoaim.cli.train import train
from geoaim.cli.view import view

COMMANDS = (
    *(frame, pick, build, align, draw, register, track, info, convert, view, texture, render),
    *(simulate, predict, evaluate, train, sample, bench, doctor),
)

app = typer.Typer(
    name="geoaim",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # without a terminal, wrong usage is one plain line instead of a box of 80 columns
    rich_markup_mode="rich" if sys.stderr.isatty() else None,
)


def _print_version(is_asked: bool) -> bool:
    if is_asked:
        typer.echo(__version__)
        raise typer.Exit
    return is_asked


@app.callback()
def prepare(
    debug: Annotated[bool, typer.Option("--debug", help="print the full traceback")] = False,
    version: Annotated[
        bool, typer.Option("--version", help="print the version", callback=_print_version)
    ] = False,
) -> None:
    """Aerial image-based maps (AIM) from drone video: build, render, simulate, predict."""
    DEBUG.set(debug)
    stop_when_terminated()


for command in COMMANDS:
    app.command()(command)
app.add_typer(catalog)
