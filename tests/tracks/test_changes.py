from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoaim import Tracks, World
from geoaim.base.errors import TracksError
from geoaim.tracks.changes import cut_tracks, merge_tracks, resample_tracks, to_world


def _straight(times, present=None, heading=0.0, speed=2.0):
    times = np.asarray(times, float)
    present = np.ones((1, len(times)), bool) if present is None else np.array([present], bool)
    direction = np.array([np.cos(heading), np.sin(heading)])
    states = np.empty((1, len(times), 4))
    states[0, :, :2] = 5.0 + speed * times[:, None] * direction
    states[0, :, 2:] = heading, speed
    states[~present] = np.nan
    return Tracks(times, states, present, np.array([[4.5, 1.8]]), ("car",), ("1",), World(None))


def test_resampling_is_linear_between_states_and_exact_at_them():
    tracks = _straight([0.0, 0.1, 0.3])
    states = tracks.states.copy()
    states[0, :, 3] = 1.0, 2.0, 4.0
    again = resample_tracks(replace(tracks, states=states), 20)
    np.testing.assert_allclose(again.times, np.arange(7) / 20)
    np.testing.assert_allclose(again.states[0, :, 3], [1, 1.5, 2, 2.5, 3, 3.5, 4])
    np.testing.assert_array_equal(again.states[0, [0, 2, 6]], states[0])


@given(
    steps=st.lists(st.floats(0.01, 0.4), min_size=2, max_size=12),
    start=st.floats(-1e5, 1e5),
    rate=st.floats(0.5, 60),
    heading=st.floats(-3.1, 3.1),
)
def test_resampled_straight_motion_stays_straight(steps, start, rate, heading):
    offsets = np.concatenate([[0.0], np.cumsum(steps)])
    tracks = _straight(offsets, heading=heading)
    tracks = replace(tracks, times=offsets + start)
    again = resample_tracks(tracks, rate)
    assert again.present.all()
    assert again.times[-1] <= tracks.times[-1] + 1e-6 < again.times[-1] + 1 / rate + 1e-6
    wanted = _straight(again.times - start, heading=heading)
    np.testing.assert_allclose(again.states, wanted.states, atol=1e-5)


def test_resampled_heading_turns_the_shorter_way():
    tracks = _straight([0.0, 0.4])
    states = tracks.states.copy()
    states[0, :, 2] = 3.0, -3.0
    heading = resample_tracks(replace(tracks, states=states), 10).states[0, :, 2]
    assert (heading >= -np.pi).all()
    assert (heading < np.pi).all()
    turn = 2 * np.pi - 6
    np.testing.assert_allclose(
        np.exp(1j * heading), np.exp(1j * (3 + turn * np.arange(5) / 4)), atol=1e-12
    )


def test_resampling_fills_a_missing_row_and_keeps_an_absence():
    present = np.ones(20, bool)
    present[3] = present[8:14] = False  # 0.2 s and 0.7 s between the rows beside
    tracks = _straight(np.arange(20) / 10, present)
    again = resample_tracks(tracks, 10)
    wanted = present.copy()
    wanted[3] = True
    np.testing.assert_array_equal(again.present[0], wanted)
    assert np.isnan(again.states[~again.present]).all()
    assert resample_tracks(tracks, 10, max_gap=0.7).present.all()


def test_resampling_does_not_extrapolate():
    present = [False, True, True, False]
    again = resample_tracks(_straight([0.0, 0.2, 0.4, 0.6], present), 10)
    np.testing.assert_array_equal(again.present[0], [0, 0, 1, 1, 1, 0, 0])


def test_resampling_downwards_and_back_up_keeps_ids_types_and_world():
    tracks = _straight(np.arange(5) / 10)
    again = resample_tracks(resample_tracks(tracks, 5), 10)
    assert (again.ids, again.types, again.world) == (tracks.ids, tracks.types, tracks.world)
    np.testing.assert_allclose(np.diff(again.times), 0.1)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_a_rate_that_is_not_positive_is_refused(rate):
    with pytest.raises(ValueError, match="positive number of Hz"):
        resample_tracks(_straight([0.0, 0.1]), rate)


def test_too_many_states_and_too_small_a_gap_are_refused():
    with pytest.raises(TracksError, match="cut the tracks"):
        resample_tracks(_straight(np.arange(10)), 1e9, max_gap=2)
    with pytest.raises(TracksError, match=r"are 1 s apart \(median\)"):
        resample_tracks(_straight(np.arange(10)), 10)


def test_resampling_absent_agents_keeps_them_absent():
    absent = resample_tracks(_straight([0.0, 0.1], [False, False]), 20)
    assert not absent.present.any()
    assert len(absent.times) == 3


def test_tracks_transform_to_another_world_and_back():
    here = World("EPSG:32635", (583000.0, 6062000.0))
    there = World("EPSG:3035", (5100000.0, 3400000.0))
    tracks = replace(_straight(np.arange(5) / 10, heading=0.4), world=here)
    moved = to_world(tracks, there)
    assert moved.world == there
    assert np.abs(moved.states[..., :2]).max() > 1e4
    assert abs(moved.states[0, 0, 2] - 0.4) > 0.05  # another north
    np.testing.assert_allclose(to_world(moved, here).states, tracks.states, atol=1e-3)
    nearer = to_world(tracks, World("EPSG:32635", (583100.0, 6062000.0)))
    np.testing.assert_allclose(nearer.states[..., 0], tracks.states[..., 0] - 100, atol=1e-6)


def test_tracks_without_a_place_on_the_earth_are_not_transformed():
    with pytest.raises(TracksError, match=r"give both a CRS .*--tracks-world EPSG:n.*, or neither"):
        to_world(_straight([0.0, 0.1]), World("EPSG:32635", (583000.0, 6062000.0)))


def test_cut_keeps_the_steps_and_agents_of_a_time():
    tracks = _straight(np.arange(11) / 10, present=np.arange(11) < 6)
    cut = cut_tracks(tracks, 0.3, 0.4)
    np.testing.assert_allclose(cut.times, [0.3, 0.4, 0.5, 0.6, 0.7])
    assert cut.present[0].tolist() == [True, True, True, False, False]
    with pytest.raises(TracksError, match=r"no agent is present from 0.7 to 1 s"):
        cut_tracks(tracks, 0.7, 0.3)


def test_observed_states_between_rows_move_the_last_one_on():
    tracks = _straight(np.arange(5) / 2)
    states = tracks.states.copy()
    states[0, 2:, :2] += 100.0  # a jump, of which earlier rows say nothing
    again = resample_tracks(replace(tracks, states=states), 4.0)
    before = resample_tracks(tracks, 4.0)
    np.testing.assert_array_equal(again.get_observed()[0, :4], before.get_observed()[0, :4])
    assert abs(again.states[0, 3, 0] - before.states[0, 3, 0]) > 1
    np.testing.assert_allclose(before.get_observed(), before.states, atol=1e-9)


@pytest.mark.usefixtures("unchecked")
def test_what_was_seen_and_how_certainly_is_kept():
    tracks = replace(
        _straight([0.0, 0.1, 0.2, 0.3]),
        seen=np.array([[True, True, False, True]]),
        uncertainty=np.array([[[0.1, 0.2], [0.2, 0.1], [0.4, 0.3], [0.1, 0.1]]]),
        observed_sigma=np.array([[np.nan, 3.0, 2.0, 1.0]]),
    )
    again = resample_tracks(tracks, 20)
    assert again.seen[0].tolist() == [True, True, True, False, False, False, True]
    np.testing.assert_allclose(
        again.uncertainty[0, :4], [[0.1, 0.2], [0.2, 0.2], [0.2, 0.1], [0.4, 0.3]]
    )
    np.testing.assert_array_equal(again.observed_sigma, [[np.nan, np.nan, 3, 3, 2, 2, 1]])
    assert cut_tracks(tracks, 0.1, 0.1).seen.tolist() == [[True, False]]
    assert cut_tracks(tracks, 0.1, 0.1).observed_sigma.tolist() == [[3.0, 2.0]]
    assert merge_tracks([tracks, tracks]).observed_sigma.shape == (2, 4)
    assert merge_tracks([tracks, replace(tracks, observed_sigma=None)]).observed_sigma is None
    assert to_world(tracks, World(None)).uncertainty is tracks.uncertainty
    with pytest.raises(ValueError, match=r"seen has the shape \(1, 3\); \(1, 4\) is needed"):
        replace(tracks, seen=tracks.seen[:, :3])


def test_merged_tracks_have_all_agents_at_all_times():
    cars, walkers = _straight([0.0, 0.1, 0.2]), _straight([0.1, 0.25], heading=1.0)
    walkers = replace(walkers, types=("pedestrian",), observed=walkers.states + 0.5)
    both = merge_tracks([cars, walkers])
    np.testing.assert_allclose(both.times, [0, 0.1, 0.2, 0.25])
    assert both.ids == ("1", "2-1")
    assert both.types == ("car", "pedestrian")
    assert both.present.tolist() == [[True, True, True, False], [False, True, False, True]]
    np.testing.assert_array_equal(both.states[1, [1, 3]], walkers.states[0])
    np.testing.assert_array_equal(both.observed[1, [1, 3]], walkers.observed[0])
    np.testing.assert_array_equal(both.observed[0, :3], cars.states[0])
    even = resample_tracks(both, 20)
    assert even.present.tolist() == [[True] * 5 + [False], [False] * 2 + [True] * 4]


def test_one_file_is_merged_to_itself_and_ids_stay_unique():
    one = replace(_straight([0.0, 1.0]), seen=np.ones((1, 2), bool))
    assert (merge_tracks([one]).seen == one.seen).all()
    assert merge_tracks([one]).observed is None
    assert merge_tracks([one, one, one]).ids == ("1", "2-1", "3-1")
    assert merge_tracks([one, _straight([0.0, 1.0])]).seen is None


def test_tracks_of_other_times_or_planes_are_not_merged():
    one = _straight([0.0, 1.0])
    with pytest.raises(TracksError, match="of file 2 from 5 to 6 s; give files of one recording"):
        merge_tracks([one, _straight([5.0, 6.0])])
    with pytest.raises(TracksError, match="give both a CRS"):
        merge_tracks([one, replace(one, world=World("EPSG:32632"))])
    with pytest.raises(ValueError, match="no tracks to merge"):
        merge_tracks([])
