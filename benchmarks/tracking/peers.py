"""Trackers to compare with: ByteTrack, OC-SORT and BoT-SORT in pixels, then placed in the world.

They run as their users run them, with their defaults and the frame rate. HOTA and IDF1 judge their
own boxes, with gaps filled and short tracks dropped as ours are. They are measured where roboflow's
trackers is installed: `pip install trackers`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment

from geoaim.base.errors import TracksError
from geoaim.base.world import World
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.tracking.association import MIN_HITS
from geoaim.tracking.ground_detections import place_boxes
from geoaim.tracking.kalman import predict, start, update
from geoaim.tracks.formats.motion import make_tracks_from_positions
from geoaim.tracks.tracks import Tracks

HALF_WINDOW_S = 0.25  # of the differences that give headings and speeds
# of the plain filter: acceleration (px²/s³), a coordinate's noise and a first velocity (px, px/s),
# and the frames for which a track waits
KALMAN_NOISE_PX, KALMAN_SIGMA_PX, KALMAN_SPEED_PX, KALMAN_WAIT = 2000.0, 2.0, 150.0, 30
SIDES = ["left", "top", "right", "bottom"]


@dataclass(frozen=True, eq=False)
class PeerTracks:
    """Tracks, and the boxes that the tracker itself gives."""

    tracks: Tracks
    boxes: Float[Array, "N T 4"]  # pixels; NaN where there is none


Tracker = Callable[..., PeerTracks]


def list_peers() -> Mapping[str, Tracker]:
    """List the trackers that are installed, by name, each with the interface of `track_boxes`."""
    floor = {"Kalman and Hungarian": follow_by_kalman}
    try:
        from trackers import BoTSORTTracker, ByteTrackTracker, OCSORTTracker  # not dependencies
    except ImportError:
        print("trackers is not installed: pip install trackers")
        return floor

    def follow(make: Callable[..., Any], **options: object) -> Tracker:
        return lambda *given: _track(lambda rate: make(frame_rate=rate, **options), *given)

    return floor | {
        "ByteTrack": follow(ByteTrackTracker),
        "OC-SORT": follow(OCSORTTracker),
        # its camera motion is estimated from pictures, of which there are none here
        "BoT-SORT": follow(BoTSORTTracker, enable_cmc=False),
    }


def _track(
    make: Callable[[float], object],
    frames: Sequence[DetectedBoxes],
    world_from_frame: Float[Array, "T 3 3"],
    times: Float[Array, "T"],
    world: World,
    size: tuple[int, int],
) -> PeerTracks:
    """Track in pixels by a tracker of the package."""
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
    return _place(pd.concat(parts), frames, world_from_frame, times, world, size)


def follow_by_kalman(
    frames: Sequence[DetectedBoxes],
    world_from_frame: Float[Array, "T 3 3"],
    times: Float[Array, "T"],
    world: World,
    size: tuple[int, int],
) -> PeerTracks:
    """Track by the least there is: a Kalman filter of constant velocity and Hungarian assignment.

    Middles of boxes in pixels, the nearest pairs within the larger side of the box; a track ends
    after 30 frames without one. Boxes are those of the detector.
    """
    mean, covariance = np.empty((0, 2, 2)), np.empty((0, 2, 2))
    numbers, missed, count, parts = np.empty(0, int), np.empty(0, int), 0, []
    for step, frame in enumerate(frames):
        boxes = np.asarray(frame.boxes, float).reshape(-1, 4)
        middle = (boxes[:, :2] + boxes[:, 2:]) / 2
        dt = float(times[step] - times[step - 1]) if step else 0.0
        mean, covariance = predict(mean, covariance, dt, np.full(len(mean), KALMAN_NOISE_PX))
        offset = mean[:, None, 0] - middle[None]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        reach = (boxes[:, 2:] - boxes[:, :2]).max(axis=1, initial=0)
        rows, columns = linear_sum_assignment(np.minimum(distance / np.maximum(reach, 1e-9), 2.0))
        near = distance[rows, columns] < reach[columns]
        rows, columns = rows[near], columns[near]
        sigma = np.full(len(rows), KALMAN_SIGMA_PX)
        mean[rows], covariance[rows] = update(mean[rows], covariance[rows], middle[columns], sigma)
        missed += 1
        missed[rows] = 0
        own = np.full(len(boxes), -1)
        own[columns] = numbers[rows]
        new = np.flatnonzero(own < 0)
        own[new] = count + np.arange(len(new))
        count += len(new)
        begun = start(middle[new], np.full(len(new), KALMAN_SIGMA_PX), KALMAN_SPEED_PX)
        kept = missed <= KALMAN_WAIT
        mean = np.concatenate([mean[kept], begun[0]])
        covariance = np.concatenate([covariance[kept], begun[1]])
        numbers = np.concatenate([numbers[kept], own[new]])
        missed = np.concatenate([missed[kept], np.zeros(len(new), int)])
        part = pd.DataFrame(boxes, columns=SIDES)
        parts.append(part.assign(step=step, id=own, type=frame.get_types()))
    return _place(pd.concat(parts), frames, world_from_frame, times, world, size)


def _place(
    rows: pd.DataFrame,
    frames: Sequence[DetectedBoxes],
    world_from_frame: Float[Array, "T 3 3"],
    times: Float[Array, "T"],
    world: World,
    size: tuple[int, int],
) -> PeerTracks:
    """Fill gaps, drop short tracks, and place and difference the boxes."""
    rows = _fill_gaps(rows)
    steps = [rows[rows["step"] == step] for step in range(len(frames))]
    filled = [DetectedBoxes(part[SIDES].to_numpy(), types=tuple(part["type"])) for part in steps]
    placed = place_boxes(filled, world_from_frame, size)
    states = pd.DataFrame(
        {
            "id": np.concatenate([part["id"] for part in steps]),
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
    """Drop tracks that are short or mostly gaps; fill the gaps of the others evenly."""
    filled = []
    for name, track in rows.groupby("id"):
        span = np.arange(track["step"].min(), track["step"].max() + 1)
        if len(track) >= max(MIN_HITS, 0.4 * len(span)):
            columns = {key: np.interp(span, track["step"], track[key]) for key in SIDES}
            kind = track["type"].mode()[0]
            filled.append(pd.DataFrame(columns | {"step": span, "id": str(name), "type": kind}))
    if not filled:
        raise TracksError("no track is long enough")
    return pd.concat(filled, ignore_index=True)


def _fill_times(tracks: Tracks, times: Float[Array, "T"]) -> Tracks:
    """Give tracks all times of the frames."""
    steps = np.abs(tracks.times[:, None] - times).argmin(axis=1)
    states = np.full((len(tracks.ids), len(times), 4), np.nan)
    states[:, steps] = tracks.states
    present = np.isfinite(states[..., 0])
    return Tracks(times, states, present, tracks.sizes, tracks.types, tracks.ids, tracks.world)
