"""The viewer as a widget in notebooks: JupyterLab, VS Code, Colab, marimo."""

import os
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from geoaim.base.errors import GeoaimError
from geoaim.base.world import LONLAT
from geoaim.web.explore import (
    FuturesSource,
    HDMapSource,
    ImagerySource,
    LightsSource,
    MapSource,
    TracksSource,
    make_map_view,
    read_contents,
)
from geoaim.web.map_view import MapView, read_module
from geoaim.web.picking.page import make_picking_view
from geoaim.web.picking.session import read_task


def explore(
    aim: MapSource,
    *,
    tracks: TracksSource | None = None,
    lights: LightsSource | None = None,
    hdmap: HDMapSource | None = None,
    imagery: ImagerySource | None = None,
    futures: FuturesSource | None = None,
) -> Any:
    """Show a map and its traffic in a notebook, as an interactive widget.

    Everything may be given as an object or as the path of its file.

    Args:
        aim: the map; of a file only the parts that are shown are read.
        tracks: agents, in any world that can be brought into the map's.
        lights: traffic lights; a file needs `hdmap` for the places of their stop lines.
        hdmap: lanes, borders and markings, in the map's world.
        imagery: shown beneath the map, with a swipe between the two: an AIM in its world, or what
            `read_imagery` reads.
        futures: the result of `predict`, or a file that `geoaim predict -o futures.csv` wrote.

    Returns:
        The widget (anywidget), which JupyterLab, VS Code, Colab and marimo show.

    Raises:
        ImportError: anywidget is not installed (`pip install anywidget`).
        ValueError: lights are a file, and there is no HD map.
        GeoaimError: something cannot be read, or lies at another place than the map.

    Example:
        geoaim.explore("aim.tif", tracks="tracks.csv")
    """
    contents = read_contents(
        aim, tracks=tracks, lights=lights, hdmap=hdmap, imagery=imagery, futures=futures
    )
    stack = ExitStack()  # the file of the map is open as long as the widget lives
    return make_widget(make_map_view(aim, contents, stack), stack)


def pick(
    video: str | Path,
    path: str | os.PathLike[str] = "points.csv",
    *,
    imagery: ImagerySource | None = None,
    time: float = 0.0,
    crs: str | None = LONLAT,
) -> Any:
    """Pick control points in a notebook: on a frame, and on imagery or by typed coordinates.

    Args:
        video: a video, images or one image.
        path: the .csv that is written after each change; if it exists, picking continues with its
            points.
        imagery: an AIM, or what `read_imagery` reads; None: coordinates are typed.
        time: time of the frame, s.
        crs: CRS of the coordinates; None for a local metric plane.

    Returns:
        The widget (anywidget).

    Raises:
        ImportError: anywidget is not installed (`pip install anywidget`).
        GeoaimError: something cannot be read.

    Example:
        geoaim.pick("hover.mp4", imagery="ortho.tif")
        aim = geoaim.build_aim("hover.mp4", "points.csv")  # in a later cell
    """
    task = read_task(video, path, imagery=imagery, time=time, crs=crs)
    return make_widget(make_picking_view(task, f"{Path(video).name}: control points"), None)


def make_widget(view: MapView, resources: object) -> Any:
    """Make the widget of a view; `resources` live as long as it does."""
    try:
        import anywidget
    except ImportError as error:
        raise ImportError(
            "the widget needs anywidget: pip install anywidget; `geoaim view` and `geoaim pick` "
            "show the same in a browser without it"
        ) from error

    class ViewWidget(anywidget.AnyWidget):
        _esm = read_module()

    widget = ViewWidget()
    widget.resources = resources
    widget.on_msg(lambda sender, message, _: answer_message(view, sender.send, message))
    return widget


def answer_message(view: MapView, send: Any, message: dict[str, Any]) -> None:
    """Answer a message of the widget: {id, path} with bytes, {id, action} with a reply."""
    number = message.get("id")
    try:
        if "path" in message:
            send({"id": number}, [view.read(str(message["path"]))])
        elif view.call is not None:
            send({"id": number, "reply": view.call(message["action"])})
    except KeyError as error:
        send({"id": number, "error": str(error.args[0])})
    except (GeoaimError, ValueError) as error:
        send({"id": number, "error": str(error)})
