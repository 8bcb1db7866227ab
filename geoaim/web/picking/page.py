"""The page on which control points are picked: its pictures as tiles, its actions, the overlay.

Beside the actions of `handle` it knows "overlay"; "propose", which starts a search for pairs; and
"proposed". The last two reply with "search", how far it is, or with the state when it has ended.
"""

from base64 import b64encode
from collections.abc import Mapping
from dataclasses import replace
from threading import Lock
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from geoaim.aim.rectification import sample_nearest
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.grid import Grid
from geoaim.web.map_view import MapView
from geoaim.web.picking.actions import handle
from geoaim.web.picking.search import PairSearch
from geoaim.web.picking.session import PickingSession, open_session
from geoaim.web.picking.state import describe_session
from geoaim.web.picking.task import PickingTask
from geoaim.web.tiles import TiledRaster, encode_picture, tile_array

MAX_OVERLAY_PX = 1600  # longer side of the overlay


def make_picking_view(task: PickingTask, title: str) -> MapView:
    """Make the page of a task; its session lives in the returned view.

    Raises:
        GeoreferenceError: the file of points exists and cannot be read.
        ValueError: its name does not end in .csv.
    """
    session, lock = open_session(task), Lock()
    search: PairSearch | None = None
    rasters = {"frame": _tile_pixels(task.frame, None)}
    if task.imagery is not None:
        rasters["imagery"] = _tile_pixels(task.imagery.image, task.imagery.coverage > 0)

    def call(action: Mapping[str, Any]) -> dict[str, Any]:
        nonlocal session, search
        with lock:
            if action.get("action") == "overlay":
                return draw_overlay(session)
            if action.get("action") in ("propose", "proposed"):
                if action["action"] == "propose" and search is None:
                    search = PairSearch(session)
                session, search, reply = _follow_search(session, search)
                return reply
            session, reply = handle(session, action)
            return reply

    shown = {
        name: {"path": name, "visible": True, "opacity": 1.0} | raster.describe()
        for name, raster in rasters.items()
    }
    description = {"kind": "pick", "title": title, "imagery": None, **shown}
    return MapView(description, rasters, call=call)


def _follow_search(
    session: PickingSession, search: PairSearch | None
) -> tuple[PickingSession, PairSearch | None, dict[str, Any]]:
    """Take over the pairs of a search that has ended; the reply tells about one that has not."""
    result = None if search is None else search.get_result()
    if search is not None and result is None:
        return session, search, {"search": search.describe()}
    if result is not None and result.error:
        return session, None, {"error": result.error}
    if result is not None:
        session = replace(session, candidates=result.pairs)
    return session, None, {**describe_session(session), "notes": []}


def draw_overlay(session: PickingSession) -> dict[str, Any]:
    """Draw the frame as it lies on the imagery by the points picked so far.

    Returns:
        A data URL of the picture, and its extent (left, top, right, bottom) in pixels of the
        imagery; empty where the points do not determine the position.
    """
    matrix, imagery = describe_session(session)["imagery_from_frame"], session.task.imagery
    if matrix is None or imagery is None:
        return {}
    frame = session.task.frame
    corners = transform_points(np.array(matrix), image_corners(*frame.shape[:2]))
    limits = np.array(imagery.coverage.shape[::-1], float)
    low = np.clip(np.floor(corners.min(axis=0)), 0, limits)
    high = np.clip(np.ceil(corners.max(axis=0)), 0, limits)
    if not (high - low > 1).all():
        return {}
    scale = min(1.0, MAX_OVERLAY_PX / float(max(high - low)))
    width, height = (int(side) for side in np.ceil((high - low) * scale))
    picture_from_imagery = np.array(
        [[scale, 0.0, -scale * low[0]], [0.0, scale, -scale * low[1]], [0.0, 0.0, 1.0]]
    )
    opaque = np.dstack([frame, np.full(frame.shape[:2], 255, np.uint8)])
    frame_from_picture = np.linalg.inv(picture_from_imagery @ np.array(matrix))
    picture = sample_nearest(opaque, frame_from_picture, (height, width))
    content = b64encode(encode_picture(picture)).decode()
    return {"url": f"data:image/*;base64,{content}", "extent": [*low.tolist(), *high.tolist()]}


def _tile_pixels(image: UInt8[Array, "H W 3"], covered: Array | None) -> TiledRaster:
    """Make tiles of an image in its own pixels: x is u, and y is -v."""
    height, width = image.shape[:2]
    alpha = np.full((height, width), 255, np.uint8)
    if covered is not None:
        alpha[~covered] = 0
    return tile_array(np.dstack([image, alpha]), Grid((height, width), np.diag([1.0, -1.0, 1.0])))
