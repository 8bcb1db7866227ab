"""Backgrounds of several methods and by the number of frames: tables and charts."""

import time
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import cv2
import numpy as np
import pandas as pd

from benchmarks.background.drawn_queue import draw_queue
from benchmarks.background.methods import SEEDS, STANDING, make_clips, measure_methods
from benchmarks.background.queue_clips import QueueClip, paste_queue
from benchmarks.background.real import measure_real
from benchmarks.charts import draw_fronts, draw_sizes
from benchmarks.curves import average_methods, judge_choices, mark_pareto_fronts, summarise_sizes
from benchmarks.data import find_data
from benchmarks.results import Results, Row, collect
from geoaim.base.progress import Progress
from geoaim.mapping.georeference.from_telemetry import make_local_georeference
from geoaim.mapping.pipeline import build_aim
from geoaim.mapping.sampling import FrameCount

FRAMES = 64  # frames of a clip, as many as "auto" takes at most
COUNTS = (8, 16, 32, 64)
TOLERANCE = 1.0  # grey levels, of the choice of the number of frames
SHARES = (0.0, 0.2, 0.4, STANDING)  # shares of the time that queues stand
AXES = ("ms of a processor a frame", "RMSE where queues stood, grey levels")


def measure_backgrounds(quick: bool, progress: Progress) -> Results:
    """Measure other methods where queues stand, and how many frames a background needs.

    Args:
        quick: whether to take one drawn clip.
        progress: called with what is measured, what is done and all there is.

    Returns:
        Tables and charts.
    """
    cv2.setNumThreads(1)
    data = find_data()
    real = data is not None
    rows = collect(_measure_clips(quick, real), "clips and methods", progress)
    cases = collect(measure_counts(quick, real), "clips by number of frames", progress)
    sizes = list(average_counts(cases))
    clips = pd.DataFrame(rows).groupby("clip", sort=False)
    panels = {str(name): average_methods(own, ["ms", "stood"]) for name, own in clips}
    tables: dict[str, Sequence[Row]] = {
        "rows": rows,
        "fronts": mark_pareto_fronts(panels, "ms", "stood"),
        "defaults": summarise_sizes(sizes),
        "choice of the number of frames": [judge_choices(cases, TOLERANCE)],
        "real": list(measure_real(data)) if data and not quick else [],
        "sizes": sizes,
        "cases": cases,
    }
    charts = {
        "fronts": draw_fronts(panels, cost="ms", error="stood", labels=AXES),
        "sizes": draw_sizes(sizes, {"frames": "mean RMSE, grey levels"}),
    }
    return Results("Backgrounds without traffic", tables, charts)


def _measure_clips(quick: bool, real: bool) -> Iterator[dict[str, Any]]:
    for name, seed, clip in make_clips(quick, real=real):
        for row in measure_methods(clip):
            yield {"clip": name, "seed": seed, **row}


def measure_counts(quick: bool, real: bool) -> Iterator[dict[str, Any]]:
    """Build maps of clips from fixed numbers of frames and from the automatic one.

    Args:
        quick: whether to build one clip.
        real: whether there are real data.

    Yields:
        Cases as `judge_choices` takes them; errors are over the whole image.
    """
    places = ("minsk_junction", "munich_street02") if real and not quick else ()
    for place, standing in product((*places, None), SHARES[-1:] if quick else SHARES):
        seed = SEEDS[0]
        if place is None:
            clip = draw_queue(standing=standing, seed=seed, count=FRAMES)
        else:
            clip = paste_queue(place, standing=standing, seed=seed, count=FRAMES)
        *fixed, chosen = (_build(clip, count) for count in (*COUNTS, "auto"))
        yield {
            "case": f"{place or 'drawn'}, standing {standing:g} of the time",
            "errors": [error for error, _, _ in fixed],
            "sizes": list(COUNTS),
            "times": [ms for _, ms, _ in fixed],
            "error": chosen[0],
            "ms": chosen[1],
            "size": chosen[2],
        }


def _build(clip: QueueClip, frames: FrameCount) -> tuple[float, float, int]:
    """Root mean square error of a map, ms of a processor, and the number of frames behind it."""
    size = clip.ground.shape[:2]
    start = time.process_time()
    aim = build_aim(clip.frames, make_local_georeference(resolution=0.1, size=size), frames=frames)
    ms = 1e3 * (time.process_time() - start)
    error = np.sqrt(((aim.image.astype(np.float32) - clip.ground) ** 2).mean())
    return float(error), ms, int(aim.report["registration"]["valid"])


def average_counts(cases: Sequence[Row]) -> Iterator[dict[str, Any]]:
    """Average error and time over the cases, for each number of frames and the automatic one."""
    for number, count in enumerate((*COUNTS, None)):
        errors = [case["error"] if count is None else case["errors"][number] for case in cases]
        times = [case["ms"] if count is None else case["times"][number] for case in cases]
        ms = float(np.mean(times))
        yield {
            "setting": "frames",
            "size": count or float(np.mean([case["size"] for case in cases])),
            "error": float(np.mean(errors)),
            "ms": ms,
            "cost": ms,
            "default": count is None,
            "automatic": count is None,
        }
