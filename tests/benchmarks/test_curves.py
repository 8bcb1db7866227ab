import numpy as np
import pytest

from benchmarks.charts import draw_fronts, draw_sizes
from benchmarks.curves import (
    find_knee,
    find_pareto_front,
    judge_choices,
    mark_pareto_fronts,
    summarise_sizes,
)
from benchmarks.results import Results, write_results
from geoaim.base.labels import label_points


def array(*values):
    return np.array(values, float)


def test_front_has_the_points_that_no_other_beats():
    front = find_pareto_front(array(1, 2, 3, 4, 2), array(9, 5, 6, 1, 5))
    assert front.tolist() == [True, True, False, True, True]  # equal points are both on it


def test_points_without_a_figure_are_on_no_front():
    assert find_pareto_front(array(1, np.nan, 3), array(5, 0.1, np.nan)).tolist() == [1, 0, 0]


@pytest.mark.parametrize(
    ("cost", "error", "knee"),
    [
        ((1, 2, 4, 8, 16), (16, 8, 4, 3.9, 3.8), 2),  # a corner
        ((16, 8, 4, 2, 1), (3.8, 3.9, 4, 8, 16), 2),  # in any order
        ((1, 2, 4), (8, 4, 2), 0),  # a line along which cost x error is the same: the cheapest
        ((1, 2, 4), (16, 4, 1), 2),  # a steep line: all of it pays
        ((1, 2, 4), (1, 0.9, 0.81), 0),  # a flat line: nothing pays
        ((1, 2, 4, 8), (8, 7.5, 6, 0.9), 3),  # the most is gained at the end
        ((1, 2, 4, 8), (8, 1, 3, 2), 1),  # dominated points do not count
        ((5,), (1,), 0),
    ],
)
def test_knee(cost, error, knee):
    assert find_knee(array(*cost), array(*error)) == knee


def make_sizes(default):
    cost, error = (1, 2, 4, 8), (8, 2, 1.9, 1.8)
    return [
        {"setting": "n", "size": c, "cost": c, "ms": c, "error": e, "default": c == default}
        for c, e in zip(cost, error, strict=True)
    ]


@pytest.mark.parametrize(("default", "place"), [(1, "before"), (2, "at"), (8, "beyond")])
def test_default_is_compared_with_the_knee(default, place):
    [row] = summarise_sizes(make_sizes(default))
    assert (row["knee"], row["the default is"]) == (2, f"{place} the knee")
    assert row["cost over the knee's"] == default / 2


def test_choices_are_judged_in_hindsight():
    cases = [
        {"errors": [1.0, 2.0], "sizes": [2, 8], "error": 1.04, "size": 2},
        {"errors": [4.0, 1.0], "sizes": [2, 8], "error": 1.2, "size": 8},
    ]
    row = judge_choices(cases, tolerance=0.5)
    assert row["within 5 % of the best, %"] == 50
    assert row["within 5 % or the tolerance, %"] == 100
    assert row["richest within 5 %, %"] == 50
    assert (row["mean size chosen"], row["mean size of the richest"]) == (5, 8)
    assert row["error over the best"] == pytest.approx(np.sqrt(1.04 * 1.2))


def test_names_on_a_chart_cover_no_mark_and_no_name():
    rows = [{"method": f"method {n}", "ms": 10 + 0.2 * n, "px": 1 + 0.02 * n} for n in range(5)]
    rows += [{"method": "far", "ms": 900.0, "px": 0.1}]
    figure = draw_fronts({"a": rows}, cost="ms", error="px", labels=("ms", "px"))
    boxes = [text.get_window_extent() for text in figure.axes[0].texts]
    assert len(boxes) == 6
    assert sum(box.count_overlaps(boxes) - 1 for box in boxes) == 0
    places = figure.axes[0].transData.transform([[row["ms"], row["px"]] for row in rows])
    assert not any(box.contains(*place) for box in boxes for place in places)
    label_points(figure.axes[0], np.full((1, 2), np.nan), ["without a figure"])
    assert len(figure.axes[0].texts) == 6


def test_results_are_written_as_json_markdown_and_charts(tmp_path):
    sizes = make_sizes(2)
    chart = draw_sizes(sizes, {"n": "error, px"})
    tables = {"rows": mark_pareto_fronts({"all": sizes}, "cost", "error"), "none": []}
    paths = write_results(Results("Title", tables, {"sizes": chart}), tmp_path, "n", "geoaim x")
    assert {path.name for path in paths} == {"n.json", "n.md", "n-sizes.svg", "n-sizes.png"}
    assert all(path.stat().st_size > 100 for path in paths)
    text = (tmp_path / "n.md").read_text("utf-8")
    assert text.startswith("# Title\n\n`geoaim x`, ")
    assert "![sizes](n-sizes.png)" in text
    assert "| all | n | 2 |" in text
