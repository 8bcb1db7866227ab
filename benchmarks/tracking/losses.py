"""Where identities are lost: the hard boxes, with tracks joined and gaps filled by the truth.

    python -m benchmarks.tracking.losses --json docs/bench/tracking_losses.json

On validation seeds. What a better way to join tracks could reach, and what a better way to bridge
gaps could, is how far IDF1 rises with either from the truth.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import typer
from jaxtyping import Int
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment

from benchmarks.results import JsonFile, print_rows, write_rows
from benchmarks.tracking.ablation import change_tracking
from benchmarks.tracking.cases import TrackingCase
from benchmarks.tracking.hard import CONDITIONS, make_cases, take_frames
from benchmarks.tracking.scores import BoxView, make_view, match_frames, score_tracks
from geoaim.tracking.ground_detections import GroundDetections
from geoaim.tracking.kalman import TrackRows
from geoaim.tracking.pipeline import track_boxes
from geoaim.tracks.agent_types import find_group
from geoaim.tracks.tracks import Tracks

SEEDS = 900, 5000, 5010, 5020, 5030, 5040
NAMES = "lost for 4 s", "all, 5 frames per second"
REACH_M = 2.0  # of a detection from its agent


def join_by_truth(truth: Tracks, rows: TrackRows, detections: GroundDetections) -> Int[Array, "N"]:
    """Join tracks whose detections are mostly of one agent, and that follow each other."""
    joined, last = np.arange(len(rows.bounds) - 1), dict[int, tuple[int, int]]()
    for track in np.argsort(rows.step[rows.bounds[:-1]]).tolist():
        part = slice(rows.bounds[track], rows.bounds[track + 1])
        seen = rows.detection[part][rows.detection[part] >= 0]
        states = truth.states[:, detections.step[seen], :2]
        distance = np.hypot(*np.moveaxis(states - detections.position[seen], 2, 0))
        votes = (np.nan_to_num(distance, nan=np.inf) < REACH_M).sum(axis=1)
        agent, begin = int(votes.argmax()), int(rows.step[part][0])
        if votes[agent] > len(seen) / 2:
            number, end = last.get(agent, (track, -1))
            if begin > end:
                joined[track] = number
                last[agent] = number, int(rows.step[part][-1])
    return np.unique(joined, return_inverse=True)[1]


def fill_by_truth(case: TrackingCase, found: Tracks, views: list[BoxView]) -> Tracks:
    """Give tracks the true states of their agents where nobody saw them."""
    agent, track, _ = match_frames(*views)[0].T
    shared = np.zeros((len(case.truth.ids), len(found.ids)))
    np.add.at(shared, (agent, track), 1)
    assert found.seen is not None
    states = found.states.copy()
    for one, other in zip(*linear_sum_assignment(-shared), strict=True):
        hidden = case.truth.present[one] & found.present[other] & ~found.seen[other]
        if shared[one, other]:
            states[other, hidden] = case.truth.states[one, hidden]
    return replace(found, states=states)


def _view(case: TrackingCase, found: Tracks) -> list[BoxView]:
    return [
        make_view(
            tracks,
            case.frame_from_world,
            case.size,
            np.array([find_group(kind) == "vehicle" for kind in tracks.types], bool),
        )
        for tracks in (case.truth, found)
    ]


def measure_losses() -> Iterator[dict[str, Any]]:
    """Measure IDF1 as it is, with joins by the truth, and with places by the truth in gaps."""
    for name in NAMES:
        errors, stride = CONDITIONS[name]
        for seed in SEEDS:
            for whole in make_cases(seed, errors):
                case = take_frames(whole, stride)
                given = case.boxes, case.world_from_frame, case.truth.times, case.truth.world
                found = track_boxes(*given, case.size)
                filled = fill_by_truth(case, found, _view(case, found))

                def join(_: Any, rows: Any, types: Any, detections: Any, *rest: Any) -> Any:
                    return join_by_truth(case.truth, rows, detections)  # noqa: B023

                with change_tracking([("states", "join_tracks", join)]):
                    joined = track_boxes(*given, case.size)
                kinds = {"IDF1": found, "joined by truth": joined, "filled by truth": filled}
                scores = {
                    kind: score_tracks(*_view(case, tracks))["IDF1"]
                    for kind, tracks in kinds.items()
                }
                yield {"boxes": name, "video": case.name, "seed": seed} | scores


def main(json: JsonFile = None) -> None:
    """Measure where identities are lost."""
    rows = list(measure_losses())
    kinds = ("IDF1", "joined by truth", "filled by truth")
    for name in NAMES:
        part = [row for row in rows if row["boxes"] == name]
        means = {kind: float(np.mean([row[kind] for row in part])) for kind in kinds}
        rows.append({"boxes": name, "video": "mean", "seed": ""} | means)
    write_rows(print_rows(rows), json, command="python -m benchmarks.tracking.losses")


if __name__ == "__main__":
    typer.run(main)
