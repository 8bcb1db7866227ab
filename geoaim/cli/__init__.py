"""The command line: each command reads files, calls the library and writes files."""

import sys
from typing import Annotated

import typer

from geoaim import __version__
from geoaim.cli.align import align
from geoaim.cli.bench import bench
from geoaim.cli.catalog import app as catalog
from geoaim.cli.console import DEBUG, Command, CommandGroup, stop_when_terminated
from geoaim.cli.detect import detect
from geoaim.cli.evaluate import evaluate
from geoaim.cli.info import info
from geoaim.cli.maps import build, draw, frame, register, texture
from geoaim.cli.pages import pick, view
from geoaim.cli.place import place
from geoaim.cli.predict import compare, predict
from geoaim.cli.simulate import render, simulate
from geoaim.cli.testing import doctor, sample
from geoaim.cli.tracks import convert, track
from geoaim.cli.train import train

CATALOG_GROUP = "Make a map"
GROUPS = {
    CATALOG_GROUP: (place, pick, build, align, draw, frame, register),
    "Tracks": (detect, track, convert),
    "Look at maps and files": (info, view, render, texture),
    "Simulate and predict": (simulate, predict, compare, evaluate, train),
    "Test and measure": (sample, bench, doctor),
}
COMMANDS = tuple(command for commands in GROUPS.values() for command in commands)

app = typer.Typer(
    name="geoaim",
    cls=CommandGroup,
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


for group, commands in GROUPS.items():
    for command in commands:
        app.command(cls=Command, rich_help_panel=group)(command)
app.add_typer(catalog, rich_help_panel=CATALOG_GROUP)
