"""Commands whose page opens in the browser: view and pick."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from geoaim.cli import options
from geoaim.cli.console import console, report_errors
from geoaim.cli.inputs import SceneFiles, SceneSource, take_scene_files
from geoaim.cli.outputs import check_output

if TYPE_CHECKING:
    from geoaim.web.map_view import MapView


@take_scene_files
def view(
    aim: options.AimFile,
    tracks: options.SceneTracks = None,
    drivable: options.DrivableFile = None,
    imagery: Annotated[
        list[str] | None, typer.Option(help="imagery to show beneath the map, with a swipe")
    ] = None,
    futures: Annotated[
        Path | None, typer.Option(help="futures that `geoaim predict -o futures.csv` wrote")
    ] = None,
    video: Annotated[
        str | None,
        typer.Option(
            help="video of the tracks, beside the map; that of a folder of place if omitted"
        ),
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

    from geoaim.cli.inputs import find_video, read_contents
    from geoaim.mapping.video.video import find_video_file
    from geoaim.web.explore import make_map_view, read_map_world
    from geoaim.web.map_view import write_html

    with report_errors(), ExitStack() as stack:
        if html is not None:
            check_output(html, (".html",), [aim, tracks, futures])
        source = SceneSource(aim, tracks, **files)
        contents = read_contents(source, read_map_world(aim), drivable)
        film = find_video(aim) if video is None else find_video_file(video)
        if film is None and video is not None:
            raise FileNotFoundError(f"{video}: no such file; a video file can be beside the map")
        contents = replace(contents, imagery=imagery or None, futures=futures, video=film)
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
    from geoaim.web.picking.session import read_task

    with report_errors():
        check_output(output, (".csv",), [Path(video)])
        plane = None if crs == "local" else crs or LONLAT
        own = None if crs == "local" else crs  # for imagery that states none
        task = read_task(
            video, output, imagery=imagery or None, time=time, crs=plane, imagery_crs=own
        )
        serve_page(make_picking_view(task, f"{Path(video).name}: control points"), browser=browser)
        if output.exists():
            console.print(f"{output}: next, geoaim build {video} --points {output} -o map.tif")
