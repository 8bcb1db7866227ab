"""The sweep as a benchmark: the test split, its tables and charts."""

from typing import Any

import cv2
import pandas as pd

from benchmarks.registration.methods import list_methods
from benchmarks.registration.stability.charts import CASE, draw_strips
from benchmarks.registration.stability.clips import SweepCase, list_cases, make_clip
from benchmarks.registration.stability.judge import (
    compare_methods,
    count_silent,
    find_best_ranks,
    measure_rejections,
    summarise,
)
from benchmarks.registration.stability.kinds import KINDS
from benchmarks.registration.stability.sweep import QUICK_KINDS, RIVALS, run_geoaim, run_rivals
from benchmarks.results import Results
from geoaim.base.progress import Progress

EVERY = 4  # one of so many clips of a kind is taken


def measure_stability(quick: bool, progress: Progress) -> Results:
    """Sweep the test split and compare with other methods.

    Args:
        quick: whether to take a few clips of a few kinds, and one other method.
        progress: called with what is measured, what is done and all there is.

    Returns:
        Tables and charts.
    """
    cv2.setNumThreads(1)
    rivals = RIVALS[:1] if quick else RIVALS
    methods = {name: method for name, method in list_methods().items() if name in rivals}
    chosen = _choose_cases(quick)
    rows: list[dict[str, Any]] = []
    for number, case in enumerate(chosen):
        progress("clips", number, len(chosen))
        clip = make_clip(case)
        rows += run_geoaim(case, clip) + run_rivals(case, clip, methods)
    progress("clips", len(chosen), len(chosen))
    return make_results(pd.DataFrame(rows))


def _choose_cases(quick: bool) -> list[SweepCase]:
    """Every fourth clip of each kind; or a few of an easy and a middle level."""
    cases: list[SweepCase] = []
    for kind in QUICK_KINDS if quick else KINDS:
        own = list(list_cases("test", [kind]))
        middle = len(KINDS[kind].levels) // 2 + 1
        cases += [case for case in own if case.rank in (1, middle)][::2] if quick else own[::EVERY]
    return cases


def make_results(frames: pd.DataFrame) -> Results:
    """Make the tables and the charts of a sweep from its judged frames."""
    table = summarise(frames)
    totals = count_silent(frames) | {
        "clips": frames[frames.method == "geoaim"].groupby(CASE).ngroups,
        "rejected_below_best_breakpoint": measure_rejections(frames, find_best_ranks(frames)),
    }
    tables = {
        "methods": compare_methods(frames),
        "totals": [totals],
        "rows": [dict(zip(table.columns, row, strict=True)) for row in table.to_numpy()],
    }
    charts = {"strips": draw_strips(frames)}
    return Results("Registration of clips that are hard in one way each", tables, charts)
