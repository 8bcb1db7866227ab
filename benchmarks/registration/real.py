"""Registration of real sequences without ground truth: how consistent it is with itself.

    python -m benchmarks.registration.real --json docs/bench/registration_real.json

Forward-backward: registering a frame to a reference, and that reference to the frame, should
cancel. Loop: registering a frame to one reference by way of another should agree with registering
it directly. Both are mean distances of the image's corners in pixels. They show the method's
scatter and the parallax of objects above the ground, not a common bias.
"""

from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import typer
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.data import require_data
from benchmarks.registration.benchmark import measure_corner_distances
from benchmarks.results import JsonFile, print_rows, write_rows
from geoaim.mapping.registration.register import Registration, count_reasons, register
from geoaim.mapping.video.detections import Detections, read_detections

SEQUENCES = ("minsk_junction", "minsk_street", "munich_mos074", "munich_street02")
REFERENCES = 4  # frames of a sequence that serve as the reference in turn


def measure_consistency(folder: Path, boxes: Detections | None) -> dict[str, Any]:
    """Register a sequence to several references, and measure forward-backward and loop errors, px.

    A row of the table; loops lead over another reference.
    """
    first = register(str(folder), detections=boxes)
    times = first.time[np.linspace(0, len(first.time) - 1, REFERENCES).astype(int)]
    model = first.reference.model
    others = [register(str(folder), detections=boxes, model=model, reference_time=t) for t in times]
    pairs = list(permutations(others, 2))
    backward = np.concatenate([_measure_forward_backward(*pair) for pair in pairs])
    loops = np.concatenate([_measure_loop(*pair) for pair in pairs])
    rejected = count_reasons(first.reason)
    return {
        "sequence": folder.name,
        "boxes": "yes" if boxes else "no",
        "model": model,
        "registered": f"{first.valid.sum()} of {len(first.valid)}",
        "rejected_because": "; ".join(rejected) or "-",
        "uncertainty_px": float(np.median(first.uncertainty[first.valid])),
        "forward_backward_px": float(np.nanmedian(backward)),
        "loop_px": float(np.nanmedian(loops)),
        "loop_p95_px": float(np.nanquantile(loops, 0.95)),
    }


def _measure_loop(one: Registration, two: Registration) -> Float[Array, " T"]:
    """Compare registration by way of the other reference with direct registration."""
    link = one.reference_from_frame[_find_reference(one, two)]
    size = one.reference.height, one.reference.width
    return measure_corner_distances(link @ two.reference_from_frame, one.reference_from_frame, size)


def _measure_forward_backward(one: Registration, two: Registration) -> Float[Array, " T"]:
    forward = one.reference_from_frame[_find_reference(one, two)]
    backward = two.reference_from_frame[_find_reference(two, one)]
    size = one.reference.height, one.reference.width
    return measure_corner_distances((forward @ backward)[None], np.eye(3)[None], size)


def _find_reference(one: Registration, two: Registration) -> int:
    return int(np.flatnonzero(one.index == two.reference.index)[0])


def main(json: JsonFile = None) -> None:
    """Measure all sequences, with and without the vehicles' boxes."""
    data = require_data("hover")
    rows = print_rows(
        measure_consistency(data / name, boxes)
        for name in SEQUENCES
        for boxes in (None, read_detections(data / name))
    )
    write_rows(rows, json, command="python -m benchmarks.registration.real")


if __name__ == "__main__":
    typer.run(main)
