"""Trackers to compare with: ByteTrack and OC-SORT in pixels, then placed in the world.

They run as their users run them, with their defaults and the frame rate. HOTA and IDF1 judge their
own boxes, with gaps filled and short tracks dropped as ours are. They are measured where roboflow's
trackers is installed: `pip install trackers`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.world import World
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.tracking.association import MIN_HIT_SHARE, MIN_HITS
from geoaim.tracking.ground_detections import place_boxes
from geoaim.tracks.formats.motion import make_tracks_from_positions
from geoaim.tracks.tracks import Tracks

HALF_WINDOW_S = 0.25  # of the differences that give headings and speeds
SIDES = ["left", "top", "right", "bottom"]


@dataclass(frozen=True, eq=False)
class PeerTracks:
    """Tracks, and the boxes that the tracker itself gives."""

    tracks: Tracks
    boxes: Float[Array, "N T 4"]  # pixels; NaN where there is none


Tracker = Callable[..., PeerTracks]


def list_peers() -> Mapping[str, Tracker]:
    """List the trackers that are installed, by name, each with the interface of `track_boxes`."""
    try:
        from trackers import ByteTrackTracker, OCSORTTracker  # peers, not dependencies
    except ImportError:
        print("trackers is not installed: pip install trackers")
        return {}

    def follow_by_bytetrack(*arguments: object) -> PeerTracks:
        return _track(lambda rate: ByteTrackTracker(frame_rate=rate), *arguments)  # type: ignore[arg-type]

    def follow_by_ocsort(*arguments: object) -> PeerTracks:
        return _track(lambda rate: OCSORTTracker(frame_rate=rate), *arguments)  # type: ignore[arg-type]

    return {"ByteTrack": follow_by_bytetrack, "OC-SORT": follow_by_ocsort}


def _track(
    make: Callable[[float], object],
    frames: Sequence[DetectedBoxes],
    world_from_frame: Float[Array, "T 3 3"],
    times: Float[Array, "T"],
    world: World,
    size: tuple[int, int],
) -> PeerTracks:
    """Track in pixels; fill gaps, drop short tracks, and place and difference the boxes."""
    import supervision

    tracker = make(float(1 / np.median(np.diff(times))))
    parts = []
    for step, frame in enumerate(frames):
        boxes = np.asarray(frame.boxes, np.float32)
        numbers = np.arange(len(boxes))
        given = supervision.Detections(
            boxes, confidence=np.ones(len(boxes), np.float32), class_id=numbers
        )
        found = tracker.update(given)  # type: ignore[attr-defined]
        found = found[found.tracker_id >= 0]
        part = pd.DataFrame(np.asarray(found.xyxy, np.float64), columns=SIDES)
        types = frame.get_types()[found.class_id]
        parts.append(part.assign(step=step, id=found.tracker_id, type=types))
    rows = _fill_gaps(pd.concat(parts))
    steps = [rows[rows["step"] == step] for step in range(len(frames))]
    filled = [
        DetectedBoxes(part[SIDES].to_numpy(), types=tuple(part["type"]), ids=tuple(part["id"]))
        for part in steps
    ]
    placed = place_boxes(filled, world_from_frame, size)
    states = pd.DataFrame(
        {
            "id": placed.ids,
            "type": placed.types,
            "time": times[placed.step],
            "x": placed.position[:, 0],
            "y": placed.position[:, 1],
            "length": placed.extent.max(axis=1),
            "width": placed.extent.min(axis=1),
        }
    )
    sizes = ["length", "width"]
    states[sizes] = states.groupby("id")[sizes].transform("median")
    tracks = make_tracks_from_positions(states, world, half_window=HALF_WINDOW_S)
    tracks = _fill_times(tracks, times)
    own = np.full((*tracks.present.shape, 4), np.nan)
    row = rows["id"].map({name: number for number, name in enumerate(tracks.ids)})
    own[row, rows["step"]] = rows[SIDES]
    return PeerTracks(tracks, own)


def _fill_gaps(rows: pd.DataFrame) -> pd.DataFrame:
    """Drop tracks as short as those that `associate` drops; fill the gaps of the others evenly."""
    filled = []
    for name, track in rows.groupby("id"):
        span = np.arange(track["step"].min(), track["step"].max() + 1)
        if len(track) >= max(MIN_HITS, MIN_HIT_SHARE * len(span)):
            columns = {key: np.interp(span, track["step"], track[key]) for key in SIDES}
            kind = track["type"].mode()[0]
            filled.append(pd.DataFrame(columns | {"step": span, "id": str(name), "type": kind}))
    return pd.concat(filled, ignore_index=True)


def _fill_times(tracks: Tracks, times: Float[Array, "T"]) -> Tracks:
    """Give tracks all times of the frames."""
    steps = np.abs(tracks.times[:, None] - times).argmin(axis=1)
    states = np.full((len(tracks.ids), len(times), 4), np.nan)
    states[:, steps] = tracks.states
    present = np.isfinite(states[..., 0])
    return Tracks(times, states, present, tracks.sizes, tracks.types, tracks.ids, tracks.world)
