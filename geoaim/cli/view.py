"""The command that shows a map in the browser."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from geoaim.cli import options
from geoaim.cli.console import console, report_errors
from geoaim.cli.outputs import check_output
from geoaim.cli.scene_options import SceneFiles, take_scene_files

if TYPE_CHECKING:
    from geoaim.web.map_view import MapView


@take_scene_files
def view(
    aim: options.AimFile,
    tracks: options.OptionalTracks = None,
    drivable: options.DrivableFile = None,
    imagery: Annotated[
        list[str] | None, typer.Option(help="imagery to show beneath the map, with a swipe")
    ] = None,
    futures: Annotated[
        Path | None, typer.Option(help="futures that `geoaim predict -o futures.csv` wrote")
    ] = None,
    html: Annotated[
        Path | None, typer.Option(help=".html to write: the view in one file, to send to others")
    ] = None,
    browser: Annotated[bool, typer.Option(help="open the page in the browser")] = True,
    *,
    files: SceneFiles,
) -> None:
    """Show a map and its traffic in the browser: play, follow agents, compare imagery.

    The page is served to this machine alone, until it is closed or Ctrl-C is pressed.

    Example: geoaim view map.tif --tracks samples/tracks.csv --hdmap samples/map.osm
    --lights samples/lights.csv
    """
    from contextlib import ExitStack
    from dataclasses import replace

    from geoaim.cli.inputs import read_contents
    from geoaim.web.explore import make_map_view, read_map_world
    from geoaim.web.map_view import write_html

    with report_errors(), ExitStack() as stack:
        if html is not None:
            check_output(html, (".html",), [aim, tracks, futures])
        source = files.make_source(aim, tracks)
        contents = read_contents(source, read_map_world(aim), drivable)
        contents = replace(contents, imagery=imagery or None, futures=futures)
        shown = make_map_view(aim, contents, stack)
        if html is None:
            serve_page(shown, browser=browser)
        else:
            write_html(shown, html)
            console.print(f"{html}: {html.stat().st_size / 1e6:.1f} MB")


def serve_page(shown: "MapView", *, browser: bool) -> None:
    """Serve a page until it is closed, and open it in the browser if wanted."""
    import webbrowser

    from geoaim.web.server import ViewServer

    with ViewServer(shown) as server:
        console.print(f"{server.address}  (Ctrl-C or closing the page stops)")
        if browser:
            webbrowser.open(server.address)
        server.wait()
