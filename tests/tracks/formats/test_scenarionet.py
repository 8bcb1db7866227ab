import os
import pickle

import numpy as np
import pytest

from geoaim.base.errors import TracksError
from geoaim.base.world import World
from geoaim.tracks.formats import read_scenarionet, read_tracks
from tests.tracks.formats import scenarionet_files as made


@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_scenario_of_another_converter_is_read(tmp_path, protocol):
    tracks = read_tracks(made.write(tmp_path / "sd_waymo_v0.1_0.pkl", protocol))
    assert (tracks.ids, tracks.types) == (("7", "8", "9"), ("car", "truck", "traffic_cone"))
    assert tracks.world == World(None, (400.0, -900.0))
    np.testing.assert_allclose(tracks.times, np.arange(made.STEPS - 1) / 10)
    np.testing.assert_allclose(tracks.states[0, 3], [1.5, 0, 0, 5], atol=1e-6)
    np.testing.assert_allclose(tracks.sizes, [[4.5, 1.8], [12, 4.8], [0.5, 0.2]], rtol=1e-6)


def test_malicious_file_is_refused_and_runs_nothing(tmp_path):
    class Attack:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "ran"),)

    path = made.write(tmp_path / "a.pkl", id=Attack())
    with pytest.raises(TracksError, match=r"a\.pkl .*names '\w+\.mkdir', which is no plain data"):
        read_tracks(path)
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tracks": None}, "it has no tracks"),
        ({"metadata": {}}, "KeyError: 'ts'"),
        ({"metadata": {"ts": np.zeros(11)}}, "time stamps do not increase"),
        ({"tracks": {}}, "no state in it is valid"),
        ({"metadata": {"ts": np.arange(5.0)}}, "a position has 11 rows of 3; 5 of 2 are needed"),
    ],
)
def test_broken_scenario_is_refused_with_its_reason(tmp_path, changes, message):
    path = made.write(tmp_path / "a.pkl", **changes)
    with pytest.raises(TracksError, match=message):
        read_scenarionet(path)


def test_other_pickles_are_refused(tmp_path):
    path = tmp_path / "a.pkl"
    with pytest.raises(FileNotFoundError):
        read_scenarionet(path)
    for content in (b"", b"hello", pickle.dumps([1]), pickle.dumps({"sd_0.pkl": {"id": "0"}})):
        path.write_bytes(content)
        with pytest.raises(TracksError, match=r"a\.pkl is not a scenario description"):
            read_scenarionet(path)
