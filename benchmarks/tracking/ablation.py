"""What each part of the tracking is worth: the validation boxes with one part left out or changed.

    python -m benchmarks.tracking.ablation --json docs/bench/tracking_ablation.json

The poses of the frames are exact; TrackEval judges identities: `pip install trackeval`.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import numpy as np
import typer

from benchmarks.results import JsonFile, print_rows, write_rows
from benchmarks.tracking.benchmark import (
    ERRORS,
    KINDS,
    SECONDS,
    VALIDATION_SEED,
    average_rows,
    measure_case,
)
from benchmarks.tracking.cases import DetectorErrors, TrackingCase, make_drawn_case
from geoaim.tracking.noise import DEFAULT_NOISE_PX
from geoaim.tracking.pipeline import track_boxes
from geoaim.tracking.sizes import ACCELERATION_NOISE

SIZE = (1080, 1920)
NOISY = DetectorErrors(noise_px=4.0)
Change = tuple[str, str, Any]  # module of the tracking, name and value


def _scale_noise(factor: float) -> list[Change]:
    values = {group: factor * value for group, value in ACCELERATION_NOISE.items()}
    return [("sizes", "ACCELERATION_NOISE", values)]


CHANGES: Mapping[str, list[Change]] = {
    "geoaim": [],
    "without smoothing back in time": [
        ("states", "smooth_tracks", lambda t, rows, filtered, n: filtered)
    ],
    "acceleration noise x 1/4": _scale_noise(0.25),
    "acceleration noise x 4": _scale_noise(4.0),
    "noise of the boxes not estimated": [
        ("states", "estimate_noise", lambda d, t, times: DEFAULT_NOISE_PX)
    ],
    "heading of the motion of the middle": [("poses", "turns_on_spot", lambda kind: True)],
    "rear axle at 0.2 of the length": [
        (module, "REAR_AXLE_SHARE", 0.2) for module in ("headings", "poses")
    ],
    "sizes typical of the types": [("states", "MIN_WHOLE_BOXES", 10**9)],
    "sizes without the Huber weights": [("sizes", "MAX_ERRORS", 1e9)],
    "cut boxes not completed": [("states", "complete_cut_boxes", lambda d, t, h, s: d.position)],
    "cut boxes as any others": [("ground_detections", "BORDER_PX", -1e9)],
    "gaps of 2 s as the frames come": [("association", "MAX_GAP_S", 2.0)],
    "tracks not joined": [
        ("states", "join_tracks", lambda motion, rows, types, *_: np.arange(len(types)))
    ],
    "false ends of tracks kept": [
        ("states", "find_false_ends", lambda m, rows, d, sigma, t: np.zeros(len(sigma), bool))
    ],
    "one way to go on for what is lost": [("joining", "JOIN_NOISE", ((6.0, 6.0),))],
    "sizes and types not compared": [
        ("association", "MAX_SIZE_COST", 0.0),
        ("association", "TYPE_COST", 0.0),
    ],
    "gate of 3 standard deviations": [("association", "GATE", 9.0)],
    "gate of 5 standard deviations": [("association", "GATE", 25.0)],
}


@contextmanager
def change_tracking(changes: list[Change]) -> Iterator[None]:
    """Change names of the tracking's modules within a block."""
    modules = [import_module(f"geoaim.tracking.{module}") for module, _, _ in changes]
    before = [getattr(module, name) for module, (_, name, _) in zip(modules, changes, strict=True)]
    try:
        for module, (_, name, value) in zip(modules, changes, strict=True):
            setattr(module, name, value)
        yield
    finally:
        for module, (_, name, _), value in zip(modules, changes, before, strict=True):
            setattr(module, name, value)


def measure_ablation(
    cases: list[TrackingCase], score: Callable[..., Any] = measure_case
) -> Iterator[Any]:
    """Measure all changes on cases; a row for each, with the averages for vehicles and people."""
    for name, changes in CHANGES.items():
        with change_tracking(changes):
            rows = [{"method": name} | row for case in cases for row in score(case, track_boxes)]
        yield from average_rows(rows)


def make_cases(errors: DetectorErrors) -> list[TrackingCase]:
    """Make the validation cases with boxes of a detector."""
    return [
        make_drawn_case(kind, VALIDATION_SEED + number, SIZE, seconds=SECONDS, errors=errors)
        for number, kind in enumerate(KINDS)
    ]


def main(json: JsonFile = None) -> None:
    """Measure what each part of the tracking is worth."""
    rows = print_rows(
        {"noise px": errors.noise_px} | row
        for errors in (ERRORS, NOISY)
        for row in measure_ablation(make_cases(errors))
    )
    write_rows(rows, json, command="python -m benchmarks.tracking.ablation")


if __name__ == "__main__":
    typer.run(main)
