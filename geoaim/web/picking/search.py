"""The search for pairs, in a thread of its own, so that picking goes on meanwhile."""

import threading
import time
from dataclasses import dataclass
from typing import Any

from geoaim.base.errors import AlignmentError, GeoaimError
from geoaim.base.progress import Progress, no_progress
from geoaim.web.picking.candidates import PairCandidate, propose_pairs
from geoaim.web.picking.positions import require_imagery
from geoaim.web.picking.session import PickingSession
from geoaim.web.picking.state import assess_session

STAGES = ("search", "refine", "verify")  # of `match_image`


def find_pairs(
    session: PickingSession, progress: Progress = no_progress
) -> tuple[PairCandidate, ...]:
    """Find pairs by matching a session's frame with its imagery.

    Args:
        session: two complete points or more tell roughly where the frame lies.
        progress: takes stage, done and total.

    Returns:
        The pairs.

    Raises:
        AlignmentError: the frame is not found where the points place it.
        ValueError: there is no imagery, or there are too few points.
    """
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
