import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning, TracksError
from geoaim.tracks.formats import read_pixels, read_tracks

DUT = "id,x_c,y_c,frame,label,x_est,y_est\n"
PLAIN = "id,frame,x,y\n"


def _write(tmp_path, head, rows):
    path = tmp_path / "tracks.csv"
    path.write_text(head + "".join(f"{row}\n" for row in rows))
    return path


def test_pixels_become_metres_from_the_top_left_corner(tmp_path):
    rows = [f"7,{100 + 20 * k},50,{6 * k},veh,1,2" for k in range(9)]
    path = _write(tmp_path, DUT, [*rows, "8,10,20,0,ped,1,2"])
    tracks = read_tracks(path, resolution=0.1, frame_rate=24.0)
    assert tracks.types == ("car", "pedestrian")
    assert tracks.world.crs is None
    np.testing.assert_allclose(tracks.times, 0.25 * np.arange(9))
    np.testing.assert_allclose(tracks.states[0, :, 0], 10 + 2 * np.arange(9))
    np.testing.assert_allclose(tracks.states[0, :, 1], -5)
    np.testing.assert_allclose(tracks.states[0, :, 2:], [[0, 8]] * 9, atol=1e-9)
    np.testing.assert_allclose(tracks.sizes, [[4.5, 1.8], [0.5, 0.5]])


def test_times_replace_frames_and_unknown_types_warn(tmp_path):
    path = _write(tmp_path, "id,time,frame,x,y\n", ["a,1.5,9,10,10", "a,1.6,9,11,10"])
    with pytest.warns(GeoaimWarning, match="unknown agent types 'unknown'"):
        tracks = read_tracks(path, resolution=0.1)
    np.testing.assert_allclose(tracks.times, [1.5, 1.6])


def test_table_has_times_alone_and_blanks_in_its_header(tmp_path):
    path = _write(tmp_path, "id, time, x, y, type\n", [f"a,{k / 10},{k},10,car" for k in range(9)])
    tracks = read_tracks(path, resolution=0.1)
    np.testing.assert_allclose(tracks.times, np.arange(9) / 10)
    assert tracks.types == ("car",)


def test_what_a_table_lacks_is_asked_for(tmp_path):
    path = _write(tmp_path, PLAIN, ["1,0,5,5"])
    with pytest.raises(ValueError, match="needs a resolution"):
        read_tracks(path, frame_rate=24)
    for rate in (None, 0.0, np.inf):
        with pytest.raises(ValueError, match=r"has frames and no times.*give frame_rate="):
            read_pixels(path, resolution=0.1, frame_rate=rate)
    path = _write(tmp_path, PLAIN, ["1,0,here,5"])
    with pytest.raises(TracksError, match="x is 'here' in row 2"):
        read_pixels(path, resolution=0.1, frame_rate=24)
