"""Registration of real sequences without truth: how consistent it is with itself.

    python -m geoaim.bench.registration_real --json docs/bench/registration_real.json

Forward-backward: registering a frame to a reference, and that reference to the frame, should
cancel. Loop: registering a frame to one reference by way of another should agree with registering
it directly. Both are mean distances of the image's corners in pixels. They show the method's
scatter and the parallax of objects above the ground, not a common bias.
"""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.bench.data import require_data
from geoaim.bench.report import format_table, write_rows
from geoaim.geometry import image_corners, transform_points
from geoaim.mapping.registration.register import Registration, register
from geoaim.mapping.video.detections import Detections, read_detections

SEQUENCES = ("minsk_junction", "minsk_street", "munich_mos074", "munich_street02")
REFERENCES = 4  # frames of a sequence that serve as the reference in turn


def measure(folder: Path, boxes: Detections | None) -> dict[str, Any]:
    """Register a sequence to several references, and measure the two consistencies."""
    first = register(str(folder), detections=boxes)
    times = first.time[np.linspace(0, len(first.time) - 1, REFERENCES).astype(int)]
    model = first.reference.model
    others = [register(str(folder), detections=boxes, model=model, reference_time=t) for t in times]
    loops, backward = [], []
    for one in others:
        for two in others:
            if one is not two:
                loops.append(_measure_loop(one, two))
                backward.append(_measure_forward_backward(one, two))
    refused = {reason for reason in first.reason if reason}
    return {
        "sequence": folder.name,
        "boxes": "yes" if boxes else "no",
        "model": model,
        "registered": f"{first.valid.sum()} of {len(first.valid)}",
        "refused_because": "; ".join(sorted(refused)) or "-",
        "uncertainty_px": float(np.median(first.uncertainty[first.valid])),
        "forward_backward_px": float(np.nanmedian(np.concatenate(backward))),
        "loop_px": float(np.nanmedian(np.concatenate(loops))),
        "loop_p95_px": float(np.nanquantile(np.concatenate(loops), 0.95)),
    }


def _measure_loop(one: Registration, two: Registration) -> Float[Array, " T"]:
    """Compare registration by way of the other reference with direct registration."""
    link = one.reference_from_frame[_find_reference(one, two)]
    return _measure_corner_distance(link @ two.reference_from_frame, one.reference_from_frame, one)


def _measure_forward_backward(one: Registration, two: Registration) -> Float[Array, " T"]:
    forward = one.reference_from_frame[_find_reference(one, two)]
    backward = two.reference_from_frame[_find_reference(two, one)]
    return _measure_corner_distance((forward @ backward)[None], np.eye(3)[None], one)


def _find_reference(one: Registration, two: Registration) -> int:
    return int(np.flatnonzero(one.index == two.reference.index)[0])


def _measure_corner_distance(
    actual: Float[Array, "T 3 3"], expected: Float[Array, "#T 3 3"], registration: Registration
) -> Float[Array, " T"]:
    """Mean distance of the frame's corners under two transforms, pixels."""
    corners = image_corners(registration.reference.height, registration.reference.width)
    distance = transform_points(actual, corners) - transform_points(expected, corners)
    return np.linalg.norm(distance, axis=-1).mean(-1)


def main(json: Annotated[Path | None, typer.Option(help="JSON to write")] = None) -> None:
    """Measure all sequences, with and without the vehicles' boxes."""
    data = require_data("hover")
    rows = []
    for name in SEQUENCES:
        folder = data / name
        rows += [measure(folder, boxes) for boxes in (None, read_detections(folder))]
    print(format_table(rows))
    write_rows(rows, json, command="python -m geoaim.bench.registration_real")


if __name__ == "__main__":
    typer.run(main)
