"""The command that says what a file is and which commands use it."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from geoaim.cli import options
from geoaim.cli.console import console, print_result, report_errors


def info(
    source: Annotated[str, typer.Argument(help="file or folder of any kind that geoaim reads")],
    as_json: options.AsJson = False,
) -> None:
    """Say what a file or folder is, and which commands use it.

    It may be a video, images, a map (AIM), imagery, tracks, traffic lights, an HD map, control
    points, hand-drawn shapes, telemetry, detections, a texture, a registration, futures or a model.

    Example: geoaim info samples/tracks.csv
    """
    from geoaim.cli.kinds import describe_file

    with report_errors():
        kind, facts, commands = describe_file(source)
        words = shlex.quote(source)
        calls = [f"geoaim {command.replace('FILE', words)}" for command in commands]
    if as_json:
        facts = {"kind": kind, **facts}
        print_result([Path(source)], facts, as_json, commands=calls)
        return
    print_result([Path(source)], {"kind": kind, **facts}, as_json)
    for call in calls:
        console.print(f"  {call}", highlight=False)
