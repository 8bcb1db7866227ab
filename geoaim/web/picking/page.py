"""The page on which control points are picked: its pictures as tiles, its actions, the overlay.

Beside the actions of `handle` it knows "overlay"; "propose", which starts a search for pairs; and
"proposed". The last two reply with "search", how far it is, or with the state when it has ended.
"""

import threading
import time
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from geoaim.aim.rectification import sample_nearest
from geoaim.base.errors import AlignmentError, GeoaimError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.grid import Grid
from geoaim.base.progress import Progress, no_progress
from geoaim.web.map_view import MapView
from geoaim.web.picking.actions import handle, require_imagery
from geoaim.web.picking.candidates import PairCandidate, propose_pairs
from geoaim.web.picking.session import PickingSession, PickingTask, open_session
from geoaim.web.picking.state import assess_session, describe_session
from geoaim.web.tiles import TiledRaster, encode_picture, tile_array

STAGES = ("search", "refine", "verify")  # of `match_image`


def find_pairs(
    session: PickingSession, progress: Progress = no_progress
) -> tuple[PairCandidate, ...]:
    """Find pairs by matching a session's frame with its imagery."""
    imagery = require_imagery(session.task)
    georeference = assess_session(session).georeference or session.task.rough
    if georeference is None:
        raise ValueError("pairs are proposed from the second point on; pick two first")
    try:
        return propose_pairs(session.task.frame, imagery, georeference, progress=progress)
    except AlignmentError as error:
        raise AlignmentError(
            f"no pairs: the imagery does not show the frame where the points place it ({error})"
        ) from error


@dataclass(frozen=True)
class SearchResult:
    """What a search ended with: pairs, or the reason why there are none."""

    pairs: tuple[PairCandidate, ...] = ()
    error: str = ""


class PairSearch:
    """One search for pairs in a thread; it ends when the main thread does."""

    def __init__(self, session: PickingSession) -> None:
        """Start the search of a session's frame in its imagery."""
        self._began, self._done = time.monotonic(), 0.0
        self._result: SearchResult | None = None
        self._thread = threading.Thread(target=self._run, args=(session,))
        self._thread.start()

    def get_result(self) -> SearchResult | None:
        """Return the result; None as long as the search goes on."""
        if not self._thread.is_alive() and self._result is None:
            return SearchResult(error="the search for pairs failed; the terminal says why")
        return self._result

    def describe(self) -> dict[str, Any]:
        """Describe how far it is: "done" of "total", and its "seconds" so far."""
        seconds = time.monotonic() - self._began
        return {"done": self._done, "total": len(STAGES), "seconds": seconds}

    def _run(self, session: PickingSession) -> None:
        try:
            self._result = SearchResult(find_pairs(session, self._progress))
        except (GeoaimError, ValueError) as error:
            self._result = SearchResult(error=" ".join(str(error).split()))

    def _progress(self, stage: str, done: float, total: float | None) -> None:
        if not threading.main_thread().is_alive():
            raise SystemExit  # the page was closed, and the program waits for its threads
        self._done = STAGES.index(stage) + done / (total or 1)


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
    """Draw the frame as it lies on the imagery by the points picked so far."""
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
    scale = min(1.0, 1600 / float(max(high - low)))
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
