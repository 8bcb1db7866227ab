"""Tracks that cannot be what they say: warned of with counts, or refused, in every format."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning, TracksError
from geoaim.base.world import World
from geoaim.tracks.files import read_plain_tracks
from geoaim.tracks.formats import read_tracks
from geoaim.tracks.formats.plausibility import (
    check_place,
    check_plausibility,
    derive_contradicted_motion,
)
from tests.tracks.formats import test_levelx, test_readers

SAMPLE = read_plain_tracks(Path(__file__).parents[3] / "samples/tracks.csv")  # 64 agents
CARS = np.flatnonzero(np.array(SAMPLE.types) == "car")  # 29


def change_states(agents, change):
    states = SAMPLE.states.copy()
    states[agents] = change(states[agents])
    return replace(SAMPLE, states=states)


def change_sizes(agents, change):
    sizes = SAMPLE.sizes.copy()
    sizes[agents] = change(sizes[agents])
    return replace(SAMPLE, sizes=sizes)


def scale_speed(states):
    return states * [1.0, 1.0, 1.0, 3.6]


def scale_position(states):
    return states * [500.0, 500.0, 1.0, 500.0]


@pytest.mark.parametrize(
    ("world", "scale", "shift", "message"),
    [
        (SAMPLE.world, 1.0, SAMPLE.world.origin, "are x and y absolute"),
        (World("EPSG:32635"), 1 / 0.3048, np.divide(SAMPLE.world.origin, 0.3048), "are they feet"),
        (World("EPSG:3857"), 1.0, (3149000.0, 7303000.0), "1.73 times .* Use EPSG:32635"),
        (SAMPLE.world, 1e-5, (28.29, 54.7), "are they degrees"),
    ],
)
def test_positions_that_lie_elsewhere_than_their_crs_are_refused(world, scale, shift, message):
    states = SAMPLE.states * [scale, scale, 1, 1] + np.array([*shift, 0, 0])
    check_place("a.csv", SAMPLE)
    with pytest.raises(TracksError, match=f"a.csv: .*{message}"):
        check_place("a.csv", replace(SAMPLE, states=states, world=world))


def reverse(states):
    return states + np.array([0.0, 0.0, np.pi, 0.0])


def swap_axes(states):
    return states[..., [1, 0, 2, 3]]


def jump(states):
    return states + 30.0 * (np.arange(states.shape[1]) % 7 == 0)[:, None] * [1.0, 0.0, 0.0, 0.0]


CASES = {
    "are larger than their type": (change_sizes, lambda sizes: 0 * sizes + [4000.0, 1000.0]),
    "are wider than long": (change_sizes, lambda sizes: sizes[:, ::-1]),
    "are faster than their type": (change_states, scale_position),
    "speed other than that of their motion": (change_states, scale_speed),
    "do not move where they head": (change_states, reverse),
    "x and y swapped": (change_states, swap_axes),
    "accelerate by more than 25": (change_states, jump),
}


def test_the_sample_is_plausible():
    check_plausibility("a.csv", SAMPLE)


@pytest.mark.parametrize("problem", CASES)
def test_some_absurd_agents_give_a_warning_with_their_number(problem):
    change, how = CASES[problem]
    with pytest.warns(GeoaimWarning, match=rf"a\.csv: .*\b\d+ of 64 agents .*{problem}") as warned:
        check_plausibility("a.csv", change(CARS[:12], how))
    assert len(warned) == 1


def test_estimates_are_not_advised_as_if_they_were_input():
    tracks = change_sizes(CARS[:12], lambda sizes: 0 * sizes + [4000.0, 1000.0])
    uncertainty = np.full((*tracks.present.shape, 2), 0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_plausibility("a.csv", replace(tracks, uncertainty=uncertainty))


@pytest.mark.filterwarnings("ignore::geoaim.base.errors.GeoaimWarning")
@pytest.mark.parametrize("problem", list(CASES)[:5])
def test_files_whose_agents_are_nearly_all_absurd_are_refused(problem):
    change, how = CASES[problem]
    with pytest.raises(TracksError, match=rf"a\.csv: .*{problem}"):
        check_plausibility("a.csv", change(np.arange(64), how))


@pytest.mark.parametrize(
    ("how", "names", "columns"),
    [(scale_speed, "Speeds are", [3]), (reverse, "Headings and speeds are", [2, 3])],
)
def test_columns_that_contradict_the_motion_are_not_used(how, names, columns):
    with pytest.warns(GeoaimWarning, match=rf"a\.csv: .*{names} taken from the positions"):
        tracks = derive_contradicted_motion("a.csv", change_states(np.arange(64), how))
    drives = np.abs(SAMPLE.states[CARS, :, 3]) > 3
    for column in columns:
        error = np.abs(tracks.states[CARS, :, column] - SAMPLE.states[CARS, :, column])[drives]
        assert np.nanmedian(np.minimum(error, 2 * np.pi - error)) < 0.1
    assert np.isnan(tracks.observed[CARS[0], np.flatnonzero(tracks.present[CARS[0]])[0], 3])


@pytest.mark.parametrize("how", [swap_axes, lambda states: states * [1.0, -1.0, 1.0, 1.0]])
def test_positions_that_mirror_the_headings_are_refused(how):
    with pytest.raises(TracksError, match=r"a\.csv: .*Are x and y swapped"):
        derive_contradicted_motion("a.csv", change_states(np.arange(64), how))


def test_an_agent_that_reverses_and_right_columns_stay_as_they_are():
    for tracks in (SAMPLE, change_states(CARS[:3], reverse)):
        assert derive_contradicted_motion("a.csv", tracks) is tracks


def test_agents_seen_once_have_their_stated_speed_checked(tmp_path):
    text = "# crs: local\nid,type,time,x,y,heading,speed,length,width\n1,car,0,0,0,0,999,4,2\n"
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(TracksError, match="1 of 1 agents are faster"):
        read_tracks(tmp_path / "a.csv")


def write_interaction(folder):
    row = "1,1,{},car,{},20.0,3.0,0.0,0.0,400.5,1.8\n"
    text = test_readers.INTERACTION + row.format(100, 10) + row.format(200, 10.3)
    (folder / "a.csv").write_text(text)
    return folder / "a.csv"


def write_ind(folder):
    path = test_levelx._write_ind(folder)
    other = next(folder.glob("*recordingMeta.csv"))
    other.write_text(other.read_text().replace("25.0,", "2500.0,"))
    return path


def write_highd(folder):
    path = test_levelx._write_highd(folder)
    other = next(folder.glob("*recordingMeta.csv"))
    other.write_text(other.read_text().replace("1,25", "1,2500"))
    return path


def write_geotrax(folder, x=459910):
    row = "1,{},0,0,0,{},5428000,49,8,4,2,0\n"
    text = test_readers.GEOTRAX + row.format(0, 459010) + row.format(0.1, x)
    (folder / "a.csv").write_text(text)
    return folder / "a.csv"


def write_sdd(folder, x=900):
    lines = [f'0 {x * k // 9} 100 {x * k // 9} 140 {6 * k} 0 0 0 "Biker"' for k in range(10)]
    (folder / "annotations.txt").write_text("\n".join(lines))
    return folder / "annotations.txt"


@pytest.mark.filterwarnings("ignore:.*taken from the positions")
@pytest.mark.parametrize(
    ("write", "options"),
    [
        (write_interaction, {}),
        (write_ind, {}),
        (write_highd, {}),
        (write_geotrax, {}),
        (write_sdd, {"resolution": 0.1}),
    ],
)
def test_every_format_is_checked(tmp_path, write, options):
    with pytest.raises(TracksError, match=r"their type can be|their motion"):
        read_tracks(write(tmp_path), **options)


@pytest.mark.parametrize("x", [10**15, -(10**9)])
@pytest.mark.parametrize(
    ("write", "options"), [(write_geotrax, {}), (write_sdd, {"resolution": 1.0})]
)
def test_positions_off_the_earth_are_refused(tmp_path, write, options, x):
    with pytest.raises(TracksError, match=r"row \d+: x .* is not in metres from the origin"):
        read_tracks(write(tmp_path, x), **options)
