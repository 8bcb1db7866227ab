"""Georeferences from simulated control points: tables and charts.

Settings were chosen on seeds 1 and 11; seed 2 is published.
"""

import warnings
from collections.abc import Sequence
from itertools import product

from benchmarks.charts import draw_fronts, draw_sizes
from benchmarks.curves import judge_choices, mark_pareto_fronts, summarise_sizes
from benchmarks.georeference.methods import NAMES, draw_regions, measure_counts, measure_row
from benchmarks.georeference.models import average_models, measure_models
from benchmarks.georeference.simulated_points import NOISES
from benchmarks.georeference.tilts import COUNTS as TILTED_COUNTS
from benchmarks.georeference.tilts import TILTS, measure_tilts, summarise_tilts
from benchmarks.results import Results, Row, collect
from geoaim.base.errors import GeoaimWarning
from geoaim.base.progress import Progress

# tolerance of the choice of a model, on maps whose points have errors of 0.5 px and more
TOLERANCE_PX = 0.5
COUNTS, MORE_COUNTS = (4, 5, 6, 8, 12), (20, 40)
QUICK_COUNTS = (4, 6, 12)
CASES = tuple(product((0.0, 2.0, 10.0), (0.0, 0.03), (6, 12, 20), (0.5, 2.0, 5.0)))
TRIALS, QUICK_TRIALS = 60, 12
AXES = ("ms of a processor", "median error at the corners, px")


def measure_georeference(quick: bool, progress: Progress) -> Results:
    """Measure errors and refusals by noise and number of points, rivals, and transform models.

    Args:
        quick: whether to take few points, sets and cases.
        progress: called with what is measured, what is done and all there is.

    Returns:
        Tables and charts.
    """
    trials = QUICK_TRIALS if quick else TRIALS
    counts = QUICK_COUNTS if quick else COUNTS
    cells = list(product(NOISES, counts))
    more = counts if quick else counts + MORE_COUNTS
    chosen = CASES[::9] if quick else CASES
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeoaimWarning)
        rows = collect(
            (measure_row(*cell, trials) for cell in cells),
            "noises and numbers of points",
            progress,
            len(cells),
        )
        sizes = collect(measure_counts(trials, more), "number of points", progress, len(more))
        cases = collect(measure_models(trials // 4, chosen), "cameras", progress, len(chosen))
        tilts = TILTS[::3] if quick else TILTS
        tilted = collect(
            measure_tilts(trials // 2, tilts, counts if quick else TILTED_COUNTS),
            "tilts",
            progress,
            2 * len(tilts) * len(counts if quick else TILTED_COUNTS),
        )
    sizes += average_models(cases)
    panels = {
        f"{row['points']} points": [
            {"method": name, "ms": row[f"{name}, ms"], "error, px": row[f"{name}, px"]}
            for name in NAMES
        ]
        for row in rows
        if row["noise"] == "normal"
    }
    tables: dict[str, Sequence[Row]] = {
        "rows": rows,
        "few points of tilted cameras": list(summarise_tilts(tilted)),
        "tilts": tilted,
        "fronts": mark_pareto_fronts(panels, "ms", "error, px"),
        "defaults": summarise_sizes(sizes),
        "choice of the model": [judge_choices(cases, TOLERANCE_PX)],
        "sizes": sizes,
        "cases": cases,
    }
    charts = {
        "fronts": draw_fronts(panels, cost="ms", error="error, px", labels=AXES),
        "sizes": draw_sizes(sizes, {"control points": AXES[1], "terms": "mean error, px"}),
        "regions": draw_regions(rows),
    }
    return Results("Georeference from simulated control points", tables, charts)
