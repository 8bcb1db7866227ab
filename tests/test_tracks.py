from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from geoaim import GeoaimError, Tracks, World, read_tracks, write_tracks
from geoaim.errors import TracksError
from geoaim.tracks import COLUMNS, estimate_heading, make_tracks

WORLD = World("EPSG:32635", (583000.0, 6062000.0))


def _tracks(present=((True, True, False), (False, True, True)), world=WORLD):
    present = np.array(present)
    states = np.arange(present.size * 4, dtype=float).reshape(*present.shape, 4) / 10
    states[~present] = np.nan
    count = len(present)
    return Tracks(
        times=np.array([0.0, 0.1, 0.2])[: present.shape[1]],
        states=states,
        present=present,
        sizes=np.tile([4.5, 1.8], (count, 1)),
        types=("car", "pedestrian")[:count],
        ids=("7", "b")[:count],
        world=world,
    )


@pytest.mark.parametrize("name", ["tracks.csv", "tracks.parquet"])
@pytest.mark.parametrize("world", [WORLD, World(None)])
def test_written_tracks_read_back(tmp_path, name, world):
    tracks = _tracks(world=world)
    write_tracks(tracks, tmp_path / name)
    again = read_tracks(tmp_path / name)
    np.testing.assert_allclose(again.states, tracks.states)
    np.testing.assert_array_equal(again.present, tracks.present)
    np.testing.assert_allclose(again.times, tracks.times, atol=1e-9)
    np.testing.assert_array_equal(again.sizes, tracks.sizes)
    assert (again.types, again.ids, again.world) == (tracks.types, tracks.ids, tracks.world)


@settings(max_examples=25, deadline=None)
@given(present=arrays(bool, (2, 3)), seed=st.integers(0, 99))
def test_csv_keeps_millimetres(tmp_path_factory, present, seed):
    if not present.any():
        return
    tracks = _tracks(present=present[present.any(axis=1)])
    states = tracks.states + np.random.default_rng(seed).normal(0, 500, tracks.states.shape)
    states[..., 2] = np.arctan2(states[..., 2], 100.0)
    moved = Tracks(
        tracks.times, states, tracks.present, tracks.sizes, tracks.types, tracks.ids, WORLD
    )
    path = tmp_path_factory.mktemp("csv") / "tracks.csv"
    write_tracks(moved, path)
    again = read_tracks(path)
    seen = moved.present.any(axis=0)
    order = [again.ids.index(name) for name in moved.ids]
    np.testing.assert_allclose(again.states[order], states[:, seen], atol=0.00051)


def test_file_says_crs_origin_and_columns(tmp_path):
    write_tracks(_tracks(), tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[:2] == ["# crs: EPSG:32635", "# origin: 583000.0 6062000.0"]
    assert lines[2] == ",".join(COLUMNS)
    assert lines[3] == "7,car,0.0,0.0,0.1,0.2,0.3,4.5,1.8"


def test_absent_agents_have_no_rows():
    frame = _tracks().to_frame()
    assert len(frame) == 4
    assert list(frame.columns) == list(COLUMNS)
    assert not frame.isna().any().any()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,type,time\n1,car,0\n", "does not say '# crs"),
        ("# crs: local\nid,type,time\n1,car,0\n", "lacks the columns x, y, heading"),
        ("# crs: local\n# origin: 5\nid\n", "origin '5' is not two numbers"),
        ("# crs: local\n" + ",".join(COLUMNS) + "\n", "no rows"),
        ("# crs: local\n" + ",".join(COLUMNS) + "\n1,car,0,a,2,3,4,5,6\n", "is no number"),
        ("# crs: local\n" + ",".join(COLUMNS) + "\n1,car,0,,2,3,4,5,6\n", "is x in row 0"),
        (
            "# crs: local\n" + ",".join(COLUMNS) + 2 * "\n1,car,0,1,2,3,4,5,6",
            "1 rows repeat an agent's time",
        ),
        ("# crs: EPSG:4326\n" + ",".join(COLUMNS) + "\n1,car,0,1,2,3,4,5,6\n", "4326"),
    ],
)
def test_what_is_no_table_of_tracks_says_why(tmp_path, text, message):
    path = tmp_path / "tracks.csv"
    path.write_text(text)
    with pytest.raises(GeoaimError, match=message):
        read_tracks(path)


def test_missing_file_is_a_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_tracks(tmp_path / "nowhere.csv")


@pytest.mark.parametrize("name", ["a.parquet", "a.csv"])
def test_binary_rubbish_is_refused(tmp_path, name):
    (tmp_path / name).write_bytes(bytes(range(256)))
    with pytest.raises(TracksError, match="is no table of tracks"):
        read_tracks(tmp_path / name)


def test_another_ending_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ValueError, match=r"must end in .csv or .parquet"):
        write_tracks(_tracks(), tmp_path / "tracks.txt")
    assert not list(tmp_path.iterdir())


def test_wrong_shapes_and_times_are_bad_calls(unchecked):
    t = _tracks()
    with pytest.raises(ValueError, match=r"sizes has the shape \(1, 2\); 2 ids"):
        Tracks(t.times, t.states, t.present, t.sizes[:1], t.types, t.ids, WORLD)
    with pytest.raises(ValueError, match="times do not increase"):
        Tracks(t.times[::-1], t.states, t.present, t.sizes, t.types, t.ids, WORLD)
    with pytest.raises(ValueError, match="not finite where its agent is present"):
        Tracks(t.times, t.states, ~t.present, t.sizes, t.types, t.ids, WORLD)


def test_ids_keep_the_order_in_which_they_come():
    rows = pd.DataFrame(
        {name: [0.1, 0.1, 0.1] for name in COLUMNS} | {"id": ["9", "10", "9"], "type": "car"}
    ).assign(time=[0.0, 0.0, 0.1])
    tracks = make_tracks(rows, World(None))
    assert tracks.ids == ("9", "10")
    assert tracks.present.tolist() == [[True, True], [True, False]]


def test_heading_is_kept_while_standing_and_known_before_the_first_step():
    velocity = np.array([[[0.0, 0], [0, 1], [0, 0], [-1, 0]]])
    np.testing.assert_allclose(
        estimate_heading(velocity), [[np.pi / 2, np.pi / 2, np.pi / 2, np.pi]]
    )


def _row(**changed):
    row = {"id": "1", "type": "car", "time": 0, "x": 1, "y": 2, "heading": 0, "speed": 1}
    return row | {"length": 4, "width": 2} | changed


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"id": ""}, "no id"),
        ({"id": None}, "no id"),
        ({"type": np.nan}, "no type"),
        ({"heading": 90}, "radians are needed"),
        ({"length": 0}, "not positive"),
        ({"time": 1.7e18}, "seconds are needed"),
    ],
)
def test_rows_that_cannot_be_meant_are_refused(changed, message):
    with pytest.raises(TracksError, match=message):
        make_tracks(pd.DataFrame([_row(**changed)]), WORLD)


def test_an_agent_may_be_called_na(tmp_path):
    path = tmp_path / "a.csv"
    write_tracks(make_tracks(pd.DataFrame([_row(id="NA"), _row(id="null")]), WORLD), path)
    assert read_tracks(path).ids == ("NA", "null")


def test_times_read_back_are_those_written(tmp_path):
    times = np.arange(3000) / 10
    tracks = make_tracks(pd.DataFrame([_row(time=time) for time in times]), WORLD)
    write_tracks(tracks, tmp_path / "a.csv")
    np.testing.assert_array_equal(read_tracks(tmp_path / "a.csv").times, times)


def test_row_with_a_field_too_many_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# crs: local\n" + ",".join(COLUMNS) + "\n1,2,0,1,2,0,1,4,2,9\n")
    with pytest.raises(TracksError, match="more fields than there are columns"):
        read_tracks(path)


def test_heading_is_brought_into_one_turn():
    tracks = make_tracks(pd.DataFrame([_row(heading=1.5 * np.pi)]), WORLD)
    assert tracks.states[0, 0, 2] == pytest.approx(-np.pi / 2)


def test_tracks_that_could_not_be_read_back_are_not_written(tmp_path):
    nobody = _tracks(present=((False, False, False),))
    with pytest.raises(ValueError, match="nobody is present"):
        write_tracks(nobody, tmp_path / "a.csv")
    close = make_tracks(pd.DataFrame([_row(), _row(time=1e-4)]), WORLD)
    with pytest.raises(ValueError, match="too close for the form"):
        write_tracks(close, tmp_path / "a.csv")
    assert list(tmp_path.iterdir()) == []


def test_agents_of_one_name_are_refused():
    tracks = _tracks()
    with pytest.raises(ValueError, match="name of another"):
        replace(tracks, ids=("7", "7"))
