r"""Accuracy, failures and speed of aligning imagery to an AIM or to tracks.

    python -m benchmarks.alignment --json docs/bench/alignment.json \
        --chart docs/images/alignment.png

Synthetic pairs: a place, and a picture of it on another day by another sensor at 0.3 to 0.6 m a
pixel, misplaced by up to 15 m, 5 degrees and 5 %. Errors are means over the place, in pixels of the
picture. Rivals match features of the whole pictures and fit a homography by MAGSAC++; fewer than
ten inliers count as refused. Real pairs and tracks need `GEOAIM_DATA`.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.alignment.pairs import (
    Pair,
    make_pairs,
    measure_error,
    misplace_picture,
    move_to_aim,
)
from benchmarks.alignment.real import measure_rotterdam, measure_songdo, measure_synthetic
from benchmarks.charts import draw_fronts
from benchmarks.data import find_data
from benchmarks.results import ChartFile, JsonFile, format_table, write_rows
from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import from_opencv
from geoaim.imagery.alignment import template_matching
from geoaim.imagery.alignment.by_image import align_image

PLACES_PER_KIND, TRIALS = 4, 4  # synthetic places of each kind; misplacements of each pair
MIN_INLIERS = 10  # number of feature matches
MAX_REPROJECTION_ERROR_PX = 2.0  # largest error of an inlier
FEATURES = 5000

Method = Callable[[Pair], tuple[Float[Array, "3 3"], float]]


def list_methods() -> dict[str, Method]:
    """List the methods by name: each gives true_from_stated (metres) and its 95 % uncertainty, m.

    The uncertainty is NaN where a method states none.
    """
    orb = cv2.ORB.create(nfeatures=FEATURES)
    sift = cv2.SIFT.create(nfeatures=FEATURES, enable_precise_upscale=True)
    return {
        "geoaim": _align,
        "geoaim, shadows not flattened": _align_with_shadows,
        "SIFT + MAGSAC++": lambda pair: (_align_by_features(pair, sift, cv2.NORM_L2), np.nan),
        "ORB + MAGSAC++": lambda pair: (_align_by_features(pair, orb, cv2.NORM_HAMMING), np.nan),
    }


def _align_by_features(pair: Pair, detector: Any, norm: int) -> Float[Array, "3 3"]:
    """Align a picture to an AIM by features of both at one resolution, and MAGSAC++."""
    step = pair.picture.resolution / pair.aim.resolution
    ground = cv2.resize(
        pair.aim.image, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA
    )
    points, descriptors = [], []
    for image in (pair.picture.image, ground):
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        keys, described = detector.detectAndCompute(grey, None)
        points.append(np.array([key.pt for key in keys]).reshape(-1, 2))
        descriptors.append(described)
    pairs = cv2.BFMatcher(norm, crossCheck=True).match(*descriptors)
    source = points[0][[match.queryIdx for match in pairs]]
    target = points[1][[match.trainIdx for match in pairs]]
    if len(source) < MIN_INLIERS:
        raise AlignmentError(f"only {len(source)} matches; {MIN_INLIERS} are needed")
    matrix, inliers = cv2.findHomography(
        source, target, cv2.USAC_MAGSAC, MAX_REPROJECTION_ERROR_PX, maxIters=10_000
    )
    if matrix is None or inliers.sum() < MIN_INLIERS:
        found = 0 if inliers is None else inliers.sum()
        raise AlignmentError(f"only {found} matches are inliers; {MIN_INLIERS} are needed")
    aim_from_ground, ground_from_picture = np.diag([step, step, 1.0]), from_opencv(matrix)
    world_from_picture = pair.aim.world_from_image @ aim_from_ground @ ground_from_picture
    return world_from_picture @ pair.picture.grid.grid_from_world


def _align(pair: Pair) -> tuple[Float[Array, "3 3"], float]:
    alignment = align_image(pair.picture, pair.aim)
    return alignment.true_from_stated, alignment.uncertainty


def _align_with_shadows(pair: Pair) -> tuple[Float[Array, "3 3"], float]:
    with patch.object(template_matching, "SHADOW_RADIUS_M", 0.0):
        return _align(pair)


def _compare_methods(
    pairs: list[Pair], trials: int, methods: dict[str, Method]
) -> list[dict[str, Any]]:
    """Compare methods on random misplacements of each pair, and on pictures of another place."""
    generator = np.random.default_rng(5)
    cases = [misplace_picture(pair, generator) for pair in pairs for _ in range(trials)]
    others = [
        replace(one, aim=other.aim, name="another place")
        for one, other in zip(cases, cases[trials * 5 :] + cases[: trials * 5], strict=True)
    ]
    others = [move_to_aim(case) for case in others[::trials]]
    return [_measure_method(name, method, cases, others) for name, method in methods.items()]


def _measure_method(
    name: str, method: Method, cases: list[Pair], others: list[Pair]
) -> dict[str, Any]:
    measured = np.array([measure_pair(case, method) for case in cases])
    errors, bounds, durations = measured.T
    answered = np.isfinite(errors)
    accepted = sum(np.isfinite(measure_pair(case, method)[0]) for case in others)
    median = float(np.median(np.where(answered, errors, np.inf)))
    inside = 100 * float((errors < bounds)[answered].mean()) if np.isfinite(bounds).any() else None
    return {
        "method": name,
        "cases": len(cases),
        "median, px": median if answered.mean() > 0.5 else None,
        "95 %, px": float(np.percentile(errors[answered], 95)) if answered.any() else None,
        "under 1 px, %": 100 * float((errors < 1).mean()),
        "refused": int((~answered).sum()),
        "over 1 px and not refused": int((errors >= 1).sum()),
        "in the 95 % region, %": inside,
        "accepted for another place": f"{accepted} of {len(others)}",
        "s": float(np.median(durations)),
    }


def measure_pair(pair: Pair, method: Method) -> tuple[float, float, float]:
    """Error and uncertainty in pixels of the picture, NaN where refused; and seconds."""
    start = time.process_time()
    try:
        matrix, bound = method(pair)
    except AlignmentError:
        return np.nan, np.nan, time.process_time() - start
    duration, pixel = time.process_time() - start, pair.picture.resolution
    return measure_error(pair, matrix) / pixel, bound / pixel, duration


def main(json: JsonFile = None, chart: ChartFile = None) -> None:
    """Compare on synthetic pairs, then measure real pairs and tracks if there are any."""
    cv2.setNumThreads(2)
    pairs = list(make_pairs(PLACES_PER_KIND))
    folder = find_data()
    compared = _compare_methods(pairs, TRIALS, list_methods())
    parts: list[Callable[[], list[dict[str, Any]]]] = [
        lambda: compared,
        lambda: measure_synthetic(pairs),
    ]
    if folder is not None:
        parts += [partial(measure, folder) for measure in (measure_songdo, measure_rotterdam)]
    rows: list[dict[str, Any]] = []
    for part in parts:
        rows += (measured := part())
        print(format_table(measured) + "\n", flush=True)
    write_rows(rows, json, command="python -m benchmarks.alignment")
    if chart is not None:
        # methods that refused over half of the cases are not shown
        shown = [row for row in compared if row["median, px"] is not None]
        panels = {f"{compared[0]['cases']} synthetic pairs of other days and sensors": shown}
        labels = ("s for a pair", "median error, px")
        figure = draw_fronts(panels, cost="s", error="median, px", labels=labels)
        figure.savefig(chart, dpi=110)
