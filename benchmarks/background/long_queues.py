"""Queues that stand for 60 and 85 % of a clip: without boxes, with all, with one in ten missing.

    python -m benchmarks.background.long_queues --json docs/bench/long_queues.json

Errors and marks are those where the ground is bare in at least one frame; how much of the queue's
place is bare in none is told beside them, since no method can show what is there.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Annotated

import cv2
import numpy as np
import pandas as pd
import typer

from benchmarks.background.drawn_queue import draw_queue
from benchmarks.background.methods import METHODS, divide_zones, measure_background
from benchmarks.background.queue_clips import QueueClip, paste_queue
from benchmarks.background.signal_queue import film_signal
from benchmarks.data import find_data
from benchmarks.results import JsonFile, Row, print_rows, write_rows

FRAMES = 64  # as many as a build takes
STANDING = (0.6, 0.85)  # shares of the time
VALIDATION_SEEDS, SEEDS = (0, 1), (20, 21)
VALIDATION_PLACES = ("minsk_junction", "munich_mos074")
PLACES = ("minsk_street", "munich_street02")  # on which real cars are pasted
NAMES = {
    "median": "median",
    "none": "geoaim",
    "all": "geoaim with boxes",
    "10 % missing": "geoaim, 10 % of the boxes missing",
}
COLUMNS = ("stood", "wrong %", "wrong marked %", "good marked %", "ms")


def measure_clip(clip: QueueClip) -> Iterator[Row]:
    """Yield a row for the median of the frames, and for each kind of boxes that the clip has."""
    never_bare = clip.share >= 1
    judged = replace(clip, share=np.where(never_bare, np.float32(np.nan), clip.share))
    stood = divide_zones(clip.share)["stood"]
    for boxes, name in NAMES.items():
        if clip.boxes is not None or "boxes" not in name:
            row = measure_background(judged, METHODS[name])
            never = 100 * float(never_bare[stood].mean())
            yield {"boxes": boxes, "never bare %": never} | {key: row[key] for key in COLUMNS}


def measure_clips(validation: bool) -> Iterator[Row]:
    """Yield the means over the seeds of each kind of clip, share of the time and kind of boxes."""
    seeds = VALIDATION_SEEDS if validation else SEEDS
    makers: dict[str, Callable[..., QueueClip]] = {"drawn": draw_queue, "signal": film_signal}
    if find_data() is not None:
        for place in VALIDATION_PLACES if validation else PLACES:
            makers[f"pasted on {place}"] = partial(paste_queue, place)
    for name, make in makers.items():
        for standing in STANDING:
            clips = (make(standing=standing, seed=seed, count=FRAMES) for seed in seeds)
            rows = pd.DataFrame([row for clip in clips for row in measure_clip(clip)])
            for boxes, own in rows.groupby("boxes", sort=False):
                means = {key: float(own[key].mean()) for key in ("never bare %", *COLUMNS)}
                yield {"clip": name, "standing": standing, "boxes": str(boxes), **means}


def main(
    json: JsonFile = None,
    validation: Annotated[bool, typer.Option(help="seeds and places of the choices")] = False,
) -> None:
    """Measure backgrounds where queues stand for long; print the table; write JSON if asked."""
    cv2.setNumThreads(1)
    rows = print_rows(measure_clips(validation))
    command = "python -m benchmarks.background.long_queues"
    write_rows(rows, json, command=command, seeds=SEEDS, frames=FRAMES)


if __name__ == "__main__":
    typer.run(main)
