import numpy as np
import pytest

from benchmarks.prediction.averages import average_seeds, bootstrap_trainings, merge_segments
from benchmarks.prediction.results import format_markdown
from geoaim.prediction.metrics import Metric, bootstrap_interval, keep_rates, summarise


def test_one_segment_has_no_interval():
    whole = merge_segments(
        {"a": Metric(np.array([2.0, 4.0]), np.ones(2)), "b rate": Metric(*np.ones((2, 1)))}
    )
    assert summarise(whole)["a"] == {"mean": 3.0, "count": 2.0, "segments": 1}
    assert list(keep_rates(whole)) == ["b rate"]
    assert format_markdown({"x": summarise(whole)}).endswith("| x | 2 | 1 | 3 | 1 |")


def test_averaging_seeds_keeps_the_number_of_segments():
    one = {"minADE": Metric(np.array([1.0, 4.0]), np.array([1.0, 2.0]))}
    other = {"minADE": Metric(np.array([3.0, 2.0]), np.array([1.0, 2.0]))}
    both = average_seeds([one, other])["minADE"]
    assert len(both.sums) == 2
    assert both.mean == pytest.approx(10 / 6)
    assert bootstrap_interval(average_seeds([one, one])["minADE"]) == bootstrap_interval(
        one["minADE"]
    )


def spread(trainings, places, *, seed=0):
    """Metrics of trainings at places, each with its own error, of 50 agents."""
    draws = np.random.default_rng(seed)
    base = draws.normal(0, places, 12) + draws.normal(0, trainings, (5, 1))
    return [[Metric(50 * np.array([value]), np.array([50.0])) for value in row] for row in base]


def test_nested_intervals_are_as_wide_as_trainings_and_places_differ():
    for trainings, places in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
        low, high = bootstrap_trainings(spread(trainings, places))
        assert (high - low > 0.3) == (trainings + places > 0)


def test_places_that_are_hard_for_both_do_not_widen_a_difference():
    hard = spread(0.0, 1.0)
    low, high = bootstrap_trainings(hard, hard)
    assert low == pytest.approx(high) == pytest.approx(0)
    with pytest.raises(ValueError, match="1 trainings at 12 places"):
        bootstrap_trainings(hard[:1])


def test_tables_have_the_columns_of_all_methods():
    counts = {"count": 20, "segments": 3}
    one = {"minADE": {"mean": 1.0, "low": 0.9, "high": 1.1, **counts}}
    both = {**one, "off-road rate": {"mean": 0.1, "low": 0.0, "high": 0.2, **counts}}
    lines = format_markdown({"pedestrians": one, "vehicles": both}).splitlines()
    assert lines[0] == "| | agents | segments | minADE | off-road rate |"
    assert lines[2] == "| pedestrians | 20 | 3 | 1 (0.9 to 1.1) | |"
