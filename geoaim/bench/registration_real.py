"""Registration on real sequences, where no truth is known: consistency with itself.

    python -m geoaim.bench.registration_real --json docs/bench/registration_real.json

Forward and backward: a frame on the reference, and the reference on that frame, should undo each
other. Loop: a frame laid on one reference and then on another should lie where it lies directly.
Both in pixels, the mean over the image's corners; they hold no more than the method's own
scatter, and parallax of what stands above the ground.
"""

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.bench.data import find_data
from geoaim.bench.report import format_table, write_rows
from geoaim.geometry import image_corners, transform_points
from geoaim.mapping.registration.register import Registration, register
from geoaim.mapping.video.detections import Boxes, read_boxes

SEQUENCES = ("minsk_junction", "minsk_street", "munich_mos074", "munich_street02")
REFERENCES = 4  # frames of a sequence that serve as the reference in turn


def measure(folder: Path, boxes: Boxes | None) -> dict[str, Any]:
    """One row: frames laid, reasons of the others, and the two consistencies."""
    first = register(str(folder), boxes=boxes)
    times = first.time[np.linspace(0, len(first.time) - 1, REFERENCES).astype(int)]
    model = first.reference.model
    others = [register(str(folder), boxes=boxes, model=model, reference_time=t) for t in times]
    loops, backward = [], []
    for one in others:
        for two in others:
            if one is not two:
                loops.append(_loop(one, two))
                backward.append(_forward_backward(one, two))
    refused = {reason for reason in first.reason if reason}
    return {
        "sequence": folder.name,
        "boxes": "yes" if boxes else "no",
        "model": model,
        "laid": f"{first.valid.sum()} of {len(first.valid)}",
        "refused_because": "; ".join(sorted(refused)) or "-",
        "uncertainty_px": float(np.median(first.uncertainty[first.valid])),
        "forward_backward_px": float(np.nanmedian(np.concatenate(backward))),
        "loop_px": float(np.nanmedian(np.concatenate(loops))),
        "loop_p95_px": float(np.nanquantile(np.concatenate(loops), 0.95)),
    }


def _loop(one: Registration, two: Registration) -> Float[Array, " T"]:
    """Every frame by way of the other's reference, against the direct way."""
    link = one.reference_from_frame[_row_of_reference(one, two)]
    return _apart(link @ two.reference_from_frame, one.reference_from_frame, one)


def _forward_backward(one: Registration, two: Registration) -> Float[Array, " T"]:
    there = one.reference_from_frame[_row_of_reference(one, two)]
    back = two.reference_from_frame[_row_of_reference(two, one)]
    return np.atleast_1d(_apart(there @ back, np.eye(3), one))


def _row_of_reference(one: Registration, two: Registration) -> int:
    return int(np.flatnonzero(one.index == two.reference.index)[0])


def _apart(found: Array, expected: Array, registration: Registration) -> Array:
    corners = image_corners(registration.reference.height, registration.reference.width)
    apart = transform_points(found, corners) - transform_points(expected, corners)
    return np.linalg.norm(apart, axis=-1).mean(-1)


def main(
    json: Annotated[Path | None, typer.Option(help="where to write the figures")] = None,
) -> None:
    """Measure all sequences, with and without boxes."""
    data = find_data()
    if data is None:
        raise SystemExit("no real data: set GEOAIM_DATA to a folder that holds hover/")
    rows = []
    for name in SEQUENCES:
        folder = data / "hover" / name
        rows += [measure(folder, boxes) for boxes in (None, read_boxes(folder))]
    print(format_table(rows))
    write_rows(rows, json, command="python -m geoaim.bench.registration_real")


if __name__ == "__main__":
    typer.run(main)
