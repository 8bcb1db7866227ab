"""Vehicles found without boxes, against the truth of made videos.

    python -m benchmarks.tracking.without_detector --json docs/bench/without_detector.json
    python -m benchmarks.tracking.without_detector --real-cars --json docs/bench/real_cars.json

Drawn places with shadows, and (with GEOAIM_DATA) two stills of Songdo with real cars on them, of
which one has also trained the network; or two junctions in Minsk with their own cars, which have
not, and on one of which nothing was chosen. The videos are encoded, and the maps built of them.
Vehicles that move and that stand at a time are judged, in the frames that are searched; cars that
are drawn with the ground, and people (7 px wide), are not.
TrackEval judges identities: `pip install trackeval`.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from benchmarks.data import find_data
from benchmarks.hover_videos import Kind
from benchmarks.results import JsonFile, print_rows, write_rows
from benchmarks.stills import STILLS
from benchmarks.tracking.benchmark import KINDS, TEST_SEED, VALIDATION_SEED
from benchmarks.tracking.filmed_cases import FilmedCase, film_drawn, film_real_cars, film_still
from benchmarks.tracking.real_cars import CONDITIONS, JUNCTIONS
from benchmarks.tracking.scores import BoxView, compute_iou, make_view, match_frames, score_tracks
from geoaim.base.errors import GeoaimError
from geoaim.base.geometry import transform_points
from geoaim.base.grid import Grid
from geoaim.base.progress import no_progress
from geoaim.detection.scale import propose_scale
from geoaim.mapping.video.video import open_video
from geoaim.tracking.pipeline import track_video
from geoaim.tracks.agent_types import find_group
from geoaim.tracks.changes import select_steps

SECONDS, STILL_FRAMES = 6.0, 60
PLACES = KINDS[:2]  # each takes minutes
STILL_KINDS: tuple[Kind, ...] = ("plain", "queue")  # of the videos of `STILLS`
REAL_FRAMES = 90  # of the videos of `CONDITIONS`, 6 s
BORDER_PX = 25.0  # vehicles whose middles are nearer to the frame's border are not judged
MIN_MOVING_SPEED = 1.0  # m/s
MIN_OVERLAP = 0.2  # IoU with an agent that is not judged; such a track is no error
PERSON_REACH = 1.0  # metres from a person's middle, within which a track is of that person
SPOT_REACH = 1.5  # metres from a spot, within which a track is of a drawn car that is parked in it


def measure_case(case: FilmedCase) -> dict[str, Any]:
    """Measure the tracks that are found in a video: shares of states, identities and errors."""
    found = track_video(case.video, case.aim, progress=no_progress)
    case = _take_steps(case, np.abs(case.truth.times[:, None] - found.times).argmin(axis=0))
    truth = case.truth
    is_vehicle = np.array([find_group(kind) == "vehicle" for kind in truth.types])
    speed = np.abs(np.nan_to_num(truth.states[..., 3]))
    judged = _view(case, truth, is_vehicle)
    others = make_view(truth, case.frame_from_world, case.size, ~is_vehicle)
    tracks = _view(case, found, np.ones(len(found.ids), bool))
    visible = _drop_others(tracks, judged, others, ~is_vehicle)
    tracks = replace(tracks, visible=visible & ~_lie_on_spots(tracks, judged, case.spots))
    pairs, _ = match_frames(judged, tracks)
    moving = speed > MIN_MOVING_SPEED
    row: dict[str, Any] = {"video": case.name}
    for name, mask in (("moving", moving), ("standing", ~moving)):
        count = int((judged.visible & mask).sum())
        hits = int(mask[pairs[:, 0], pairs[:, 2]].sum())
        row |= {f"{name} states": count, f"{name} recall": hits / count if count else np.nan}
    row["precision"] = len(pairs) / max(int(tracks.visible.sum()), 1)
    row |= score_tracks(judged, tracks)
    return row | {"proposed scale / true": _compare_scale(case)}


def _take_steps(case: FilmedCase, steps: Int[Array, " t"]) -> FilmedCase:
    """The case at some of its steps only."""
    chosen = select_steps(case.truth, steps)
    return replace(case, truth=chosen, frame_from_world=case.frame_from_world[steps])


def _lie_on_spots(
    tracks: BoxView, judged: BoxView, spots: Float[Array, "n 2"]
) -> Bool[Array, "N T"]:
    """Which tracks lie on a drawn car that is parked, and on no vehicle that is judged."""
    if not len(spots):
        return np.zeros(tracks.visible.shape, bool)
    offsets = tracks.tracks.states[..., None, :2] - spots
    on_spot = np.asarray((np.hypot(*np.moveaxis(offsets, -1, 0)) < SPOT_REACH).any(axis=2))
    for step in range(on_spot.shape[1]):
        rows = np.flatnonzero(on_spot[:, step] & tracks.visible[:, step])
        own = judged.boxes[judged.visible[:, step], step]
        overlap = compute_iou(tracks.boxes[rows, step], own).max(axis=1, initial=0)
        on_spot[rows[overlap > MIN_OVERLAP], step] = False
    return on_spot


def _compare_scale(case: FilmedCase) -> float:
    """The scale that is proposed by the vehicles over the true one; NaN where none is."""
    try:
        proposed = propose_scale([frame.image for frame in open_video(case.video).sample(4)])
    except GeoaimError:
        return np.nan
    true = Grid(case.size, np.linalg.inv(case.frame_from_world[0])).resolution
    return proposed.resolution / true


def _view(case: FilmedCase, tracks: Any, kept: Bool[Array, " N"]) -> BoxView:
    """The view of some agents whose middles lie inside the frames."""
    view = make_view(tracks, case.frame_from_world, case.size, kept)
    middles = transform_points(case.frame_from_world, tracks.states[..., :2].swapaxes(0, 1))
    limits = np.array(case.size[::-1]) - BORDER_PX
    inside = ((middles > BORDER_PX) & (middles < limits)).all(axis=2).T
    return replace(view, visible=view.visible & inside)


def _drop_others(
    tracks: BoxView, judged: BoxView, others: BoxView, people: Bool[Array, " M"]
) -> Bool[Array, "N T"]:
    """Which tracks are visible and lie on no agent that is not judged."""
    visible = tracks.visible.copy()
    places = [view.tracks.states[..., :2] for view in (tracks, others)]
    for step in range(visible.shape[1]):
        rows = np.flatnonzero(visible[:, step])
        boxes = tracks.boxes[rows, step]
        overlaps = [
            compute_iou(boxes, view.boxes[view.visible[:, step], step]).max(axis=1, initial=0)
            for view in (judged, others)
        ]
        on_other = (overlaps[1] > MIN_OVERLAP) & (overlaps[1] > overlaps[0])
        here = places[1][people & others.tracks.present[:, step], step]
        distance = np.hypot(*(places[0][rows, step, None] - here).transpose(2, 0, 1))
        on_person = (distance < PERSON_REACH).any(axis=1) & (overlaps[0] < MIN_OVERLAP)
        visible[rows[on_other | on_person], step] = False
    return visible


def make_cases(seed: int, folder: Path) -> Iterator[FilmedCase]:
    """Make the videos of drawn places and of stills."""
    for number, kind in enumerate(PLACES):
        yield film_drawn(kind, seed + number, folder, seconds=SECONDS)
    if find_data() is not None:
        for still, difficulty in zip(STILLS, STILL_KINDS, strict=True):
            yield film_still(still, difficulty, seed, folder, count=STILL_FRAMES)


def film_conditions(seed: int, folder: Path) -> Iterator[FilmedCase]:
    """Film real junctions with their own cars under all `CONDITIONS`."""
    for place in list(JUNCTIONS)[: 1 if seed == VALIDATION_SEED else None]:
        for condition in CONDITIONS:
            yield film_real_cars(place, condition, seed, folder, count=REAL_FRAMES)


def main(
    json: JsonFile = None,
    validation: Annotated[bool, typer.Option(help="the validation videos")] = False,
    real_cars: Annotated[bool, typer.Option(help="real junctions with their own cars")] = False,
) -> None:
    """Measure vehicles found without boxes."""
    cv2.setNumThreads(1)
    seed = VALIDATION_SEED if validation else TEST_SEED
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cases = film_conditions(seed, folder) if real_cars else make_cases(seed, folder)
        rows = print_rows(measure_case(case) for case in cases)
    command = "python -m benchmarks.tracking.without_detector" + " --real-cars" * real_cars
    write_rows(rows, json, command=command)


if __name__ == "__main__":
    typer.run(main)
