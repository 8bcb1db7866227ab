import pytest

from benchmarks.realism.motion import VEHICLES
from benchmarks.registration import transfer
from benchmarks.synthetic import make_sample, tracks_of

pytestmark = pytest.mark.slow


def test_rankings_are_compared_on_pairs_that_both_sources_tell_apart():
    one = {"a": 1.0, "b": 2.0, "c": 4.0, "d": 1.05}
    other = {"a": 2.0, "b": 1.0, "c": 9.0, "d": 9.0}
    agreement = transfer.compare_rankings(one, other)
    # c and d are equal in the other source, a and d nearly so in the first
    assert agreement == {"agreeing": 2, "pairs": 4, "swapped": ["a / b", "b / d"]}


def test_moving_on_is_a_better_rule_than_standing():
    tracks = tracks_of(make_sample(1, minutes=0.3, video=None))
    errors = transfer.measure_rules([tracks], VEHICLES)
    assert set(errors) == {"stand", "velocity", "mean velocity", "acceleration", "turn rate"}
    assert 0 < errors["velocity"] < errors["stand"]
