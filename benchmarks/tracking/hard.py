"""Boxes that are not plain: misses in bursts, doubled boxes, agents that are lost, few frames.

    python -m benchmarks.tracking.hard --json tracking_hard.json

Two generators: the synthetic traffic of a junction and a roundabout, and vehicles on plain lanes.
Poses are exact. Rows of peers that are not installed are kept from the JSON file, if it has any.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from json import loads
from typing import Annotated, Any

import typer

from benchmarks.results import JsonFile, print_rows, write_rows
from benchmarks.synthetic.roads.layouts import PlaceKind
from benchmarks.tracking.benchmark import SECONDS, VALIDATION_SEED, measure_case
from benchmarks.tracking.cases import DetectorErrors, TrackingCase, make_drawn_case
from benchmarks.tracking.lanes import make_lanes_case
from benchmarks.tracking.peers import list_peers
from geoaim.base.errors import TracksError
from geoaim.tracking.pipeline import track_boxes

TEST_SEED = 4900  # those from 1900, 2900 and 3900 on have been judged before
SIZE = (1080, 1920)
PLACES: tuple[PlaceKind, ...] = ("junction", "roundabout")
WITHOUT_HEIGHT = "geoaim, flying height not given"
BURSTS = DetectorErrors(misses=0.15, burst=4.0)
FALSE = DetectorErrors(false=0.05, false_s=0.6)
# by name, the errors of the detector and of how many frames one is used
CONDITIONS = {
    "plain": (DetectorErrors(), 1),
    "15 % misses in bursts": (BURSTS, 1),
    "doubled": (DetectorErrors(doubled=0.3), 1),
    "lost for 4 s": (DetectorErrors(lost_s=4.0), 1),
    "2 frames per second": (DetectorErrors(), 12),
    "false boxes of 0.6 s": (FALSE, 1),
    "false boxes of 0.6 s, lost for 4 s": (replace(FALSE, lost_s=4.0), 1),
    "errors that last": (DetectorErrors(noise_px=1.0, lasting_px=3.0), 1),
    "roofs, from 100 m": (DetectorErrors(flying_height=100.0), 1),
    "box-shaped roofs, from 100 m": (DetectorErrors(flying_height=100.0, box_shaped=True), 1),
    "all, 5 frames per second": (
        replace(BURSTS, false=0.15, noise_px=3.0, doubled=0.3, lost_s=4.0),
        5,
    ),
}


def take_frames(case: TrackingCase, stride: int) -> TrackingCase:
    """Take one of so many frames of a case."""
    every = slice(None, None, stride)
    truth = replace(
        case.truth,
        times=case.truth.times[every],
        states=case.truth.states[:, every],
        present=case.truth.present[:, every],
    )
    return replace(
        case,
        truth=truth,
        frame_from_world=case.frame_from_world[every],
        world_from_frame=case.world_from_frame[every],
        boxes=case.boxes[every],
    )


def make_cases(seed: int, errors: DetectorErrors) -> Iterator[TrackingCase]:
    """Make cases of both generators."""
    yield make_lanes_case(seed, seconds=SECONDS, errors=errors)
    for number, kind in enumerate(PLACES):
        yield make_drawn_case(kind, seed + number, SIZE, seconds=SECONDS, errors=errors)


def measure_hard(seed: int) -> Iterator[dict[str, Any]]:
    """Measure all trackers under each condition; a row for vehicles in each case."""
    trackers: dict[str, Callable[..., Any]] = {"geoaim": track_boxes, **list_peers()}
    for name, (errors, stride) in CONDITIONS.items():
        for case in make_cases(seed, errors):
            runs = [(method, tracker, case) for method, tracker in trackers.items()]
            if case.flying_height is not None:
                runs.append((WITHOUT_HEIGHT, track_boxes, replace(case, flying_height=None)))
            for method, tracker, filmed in runs:
                given = {"method": method, "boxes": name}
                try:
                    yield given | next(iter(measure_case(take_frames(filmed, stride), tracker)))
                except TracksError:  # it finds nothing
                    nothing = {"IDF1": 0.0, "IDF1 near": 0.0, "HOTA": 0.0}
                    yield given | {"video": case.name, "agents of": "vehicle"} | nothing


def main(
    json: JsonFile = None,
    validation: Annotated[bool, typer.Option(help="the validation seeds")] = False,
) -> None:
    """Measure tracks of boxes that are not plain."""
    seed = VALIDATION_SEED if validation else TEST_SEED
    rows = print_rows(measure_hard(seed))
    if json is not None and json.exists():
        run = {row["method"] for row in rows}
        rows += [row for row in loads(json.read_text("utf-8"))["rows"] if row["method"] not in run]
    write_rows(rows, json, command="python -m benchmarks.tracking.hard")


if __name__ == "__main__":
    typer.run(main)
