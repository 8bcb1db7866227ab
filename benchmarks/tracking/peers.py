"""Trackers to compare with: ByteTrack and OC-SORT in pixels, then placed in the world.

They are measured where roboflow's trackers is installed: `pip install trackers`.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.world import World
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.tracking.association import MIN_HITS
from geoaim.tracking.ground_detections import place_boxes
from geoaim.tracks.formats.motion import make_tracks_from_positions
from geoaim.tracks.tracks import Tracks

HALF_WINDOW_S = 0.25  # of the differences that give headings and speeds
Tracker = Callable[..., Tracks]


def list_peers() -> Mapping[str, Tracker]:
    """List the trackers that are installed, by name, each with the interface of `track_boxes`."""
    try:
        from trackers import ByteTrackTracker, OCSORTTracker  # peers, not dependencies
    except ImportError:
        print("trackers is not installed: pip install trackers")
        return {}

    def follow_by_bytetrack(*arguments: object) -> Tracks:
        return _track(lambda rate: ByteTrackTracker(frame_rate=rate), *arguments)  # type: ignore[arg-type]

    def follow_by_ocsort(*arguments: object) -> Tracks:
        return _track(lambda rate: OCSORTTracker(frame_rate=rate), *arguments)  # type: ignore[arg-type]

    return {"ByteTrack": follow_by_bytetrack, "OC-SORT": follow_by_ocsort}


def _track(
    make: Callable[[float], object],
    frames: Sequence[DetectedBoxes],
    world_from_frame: Float[Array, "T 3 3"],
    times: Float[Array, "T"],
    world: World,
    size: tuple[int, int],
) -> Tracks:
    """Track in pixels; place the middles of the boxes, and difference them."""
    import supervision

    tracker = make(float(1 / np.median(np.diff(times))))
    tracked = []
    for frame in frames:
        boxes = np.asarray(frame.boxes, np.float32)
        numbers = np.arange(len(boxes))
        given = supervision.Detections(
            boxes, confidence=np.ones(len(boxes), np.float32), class_id=numbers
        )
        found = tracker.update(given)  # type: ignore[attr-defined]
        found = found[found.tracker_id >= 0]
        types = tuple(frame.get_types()[found.class_id])
        ids = tuple(map(str, found.tracker_id))
        tracked.append(DetectedBoxes(np.asarray(found.xyxy, np.float64), types=types, ids=ids))
    placed = place_boxes(tracked, world_from_frame, size)
    rows = pd.DataFrame(
        {
            "id": placed.ids,
            "type": placed.types,
            "step": placed.step,
            "x": placed.position[:, 0],
            "y": placed.position[:, 1],
            "length": placed.extent.max(axis=1),
            "width": placed.extent.min(axis=1),
        }
    )
    named = rows.groupby("id")
    rows["type"] = named["type"].transform(lambda kinds: kinds.mode()[0])
    rows[["length", "width"]] = named[["length", "width"]].transform("median")
    rows = _fill_gaps(rows, times)
    tracks = make_tracks_from_positions(rows, world, half_window=HALF_WINDOW_S)
    return _fill_times(tracks, times)


def _fill_gaps(rows: pd.DataFrame, times: Float[Array, "T"]) -> pd.DataFrame:
    """Drop tracks as short as geoaim drops them, and fill the gaps of the others straight."""
    parts = []
    for _, part in rows.groupby("id"):
        if len(part) < MIN_HITS:
            continue
        known = part.drop_duplicates("step").set_index("step").sort_index()
        whole = known.reindex(np.arange(known.index[0], known.index[-1] + 1))
        whole[["x", "y"]] = whole[["x", "y"]].interpolate()
        parts.append(whole.ffill().assign(time=times[whole.index]))
    return pd.concat(parts, ignore_index=True)


def _fill_times(tracks: Tracks, times: Float[Array, "T"]) -> Tracks:
    """Give tracks all times of the frames."""
    steps = np.abs(tracks.times[:, None] - times).argmin(axis=1)
    states = np.full((len(tracks.ids), len(times), 4), np.nan)
    states[:, steps] = tracks.states
    present = np.isfinite(states[..., 0])
    return Tracks(times, states, present, tracks.sizes, tracks.types, tracks.ids, tracks.world)
