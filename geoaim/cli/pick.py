"""The command that opens the page on which control points are picked."""

from pathlib import Path
from typing import Annotated

import typer

from geoaim.cli import options
from geoaim.cli.console import console, report_errors
from geoaim.cli.outputs import check_output
from geoaim.cli.view import serve_page


def pick(
    video: options.VideoSource,
    output: Annotated[
        Path, options.output("control points, .csv; if it exists, picking goes on")
    ] = Path("points.csv"),
    imagery: Annotated[
        list[str] | None,
        typer.Option(help="imagery or an AIM of the place; coordinates are typed if omitted"),
    ] = None,
    time: Annotated[float, typer.Option(help="time of the frame, s", min=0)] = 0.0,
    crs: Annotated[
        str | None,
        typer.Option(
            help="CRS of typed coordinates: EPSG:4326 (lon, lat) if omitted, or 'local'; also of "
            "imagery that states none"
        ),
    ] = None,
    browser: Annotated[bool, typer.Option(help="open the page in the browser")] = True,
) -> None:
    """Pick control points in the browser: a frame on the left, imagery on the right.

    Click a mark on the ground in both pictures. From the second point on the page tells what the
    points give, and where the next one helps most. Each change is saved at once.

    Example: geoaim pick samples/hover.mp4 --imagery samples/ortho.tif -o points.csv
    """
    from geoaim.base.world import LONLAT
    from geoaim.web.picking.page import make_picking_view
    from geoaim.web.picking.task import read_task

    with report_errors():
        check_output(output, (".csv",), [Path(video)])
        plane = None if crs == "local" else crs or LONLAT
        own = None if crs == "local" else crs  # for imagery that states none
        task = read_task(
            video, output, imagery=imagery or None, time=time, crs=plane, imagery_crs=own
        )
        serve_page(make_picking_view(task, f"{Path(video).name}: control points"), browser=browser)
        if output.exists():
            console.print(f"{output}: next, geoaim build {video} --gcps {output} -o map.tif")
