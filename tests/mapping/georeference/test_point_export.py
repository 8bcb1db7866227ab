import csv
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from geoaim.base.errors import GeoaimWarning, GeoreferenceError
from geoaim.base.world import LONLAT
from geoaim.mapping.georeference.control_points import ControlPoints, read_control_points
from geoaim.mapping.georeference.point_export import clean_text, format_points, write_control_points

PIXEL = st.tuples(st.floats(0, 8192), st.floats(0, 8192))
LONLATS = st.tuples(st.floats(-180, 180), st.floats(-80, 80))
METRES = st.tuples(st.floats(1e5, 9e5), st.floats(0, 9e6))
TMERC = "+proj=tmerc +lat_0=54 +lon_0=28.3 +datum=WGS84 +units=m"
NAME = st.text(min_size=1, max_size=12)
FRAME = st.none() | st.integers(0, 9999) | st.sampled_from(["a.jpg", "DJI, 1.JPG", "#2.png"])


def make_points(rows, crs=LONLAT):
    pixels, coordinates, names, frames = zip(*rows, strict=True)
    return ControlPoints(np.array(pixels), np.array(coordinates), crs, names, frames)


def write_and_read(points, name):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        write_control_points(points, path)
        return read_control_points(path)


def check_numbers(found, points, tolerance=0.0):
    np.testing.assert_allclose(found.pixels, points.pixels, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.coordinates, points.coordinates, rtol=0, atol=tolerance)
    assert found.crs == points.crs


@given(st.lists(st.tuples(PIXEL, LONLATS, NAME, FRAME), min_size=1, max_size=5))
@example([((1.0, 2.0), (3.0, 4.0), '#1, "kerb"; östlich\n\x85', None)])
def test_csv_keeps_every_point_its_name_and_its_frame(rows):
    points = make_points(rows)
    found = write_and_read(points, "points.csv")
    check_numbers(found, points)
    names = [clean_text(name) or f"point {i}" for i, name in enumerate(points.names, 1)]
    assert list(found.names) == names
    assert found.frames == points.frames


@given(st.lists(st.tuples(PIXEL, METRES, NAME, FRAME), min_size=1, max_size=5))
def test_lists_of_opendronemap_and_qgis_give_the_same_places(rows):
    points = make_points(rows, "EPSG:32635")
    check_numbers(write_and_read(points, "points.points"), points)
    found = write_and_read(points, "gcp_list.txt")
    check_numbers(found, points)
    assert found.frames == tuple(
        frame.replace(" ", "_") if isinstance(frame, str) else frame or 0 for frame in points.frames
    )


@pytest.mark.parametrize("crs", [None, "EPSG:32635", TMERC])
def test_csv_states_the_crs_and_the_accuracy(crs):
    points = replace(make_points([((1.0, 2.0), (5e5, 6e6), "a", None)], crs), accuracy=0.25)
    found = write_and_read(points, "points.csv")
    assert (found.crs, found.accuracy) == (crs, 0.25)


def test_a_crs_that_opendronemap_cannot_state_becomes_degrees():
    points = make_points([((1.0, 2.0), (500.0, -700.0), "a", None)], TMERC)
    assert format_points(points, ".txt").splitlines()[0] == LONLAT


def test_a_local_plane_is_refused_for_opendronemap():
    points = make_points([((1.0, 2.0), (5.0, 6.0), "a", None)], None)
    with pytest.raises(GeoreferenceError, match=r"local plane.*csv"):
        format_points(points, ".txt")


INCOMPLETE = [
    ((1.0, 2.0), (27.0, 53.0), "both", None),
    ((np.nan, np.nan), (28.0, 54.0), "place only", None),
    ((3.0, 4.0), (np.nan, np.nan), "pixel only", None),
]


def test_csv_has_empty_fields_for_what_is_not_picked_and_reading_says_so(tmp_path):
    write_control_points(make_points(INCOMPLETE), tmp_path / "points.csv")
    with (tmp_path / "points.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[2:] == [
        ["place only", "", "", "28.0", "54.0"],
        ["pixel only", "3.0", "4.0", "", ""],
    ]
    with pytest.warns(GeoaimWarning, match="left out: place only, pixel only"):
        assert read_control_points(tmp_path / "points.csv").names == ("both",)
    kept = read_control_points(tmp_path / "points.csv", keep_incomplete=True)
    assert kept.names == ("both", "place only", "pixel only")
    np.testing.assert_array_equal(np.isnan(kept.pixels[:, 0]), [False, True, False])


def test_a_file_without_a_complete_point_is_refused(tmp_path):
    write_control_points(make_points(INCOMPLETE[1:]), tmp_path / "points.csv")
    with pytest.raises(GeoreferenceError, match="both a pixel and a place: place only, pixel only"):
        read_control_points(tmp_path / "points.csv")


def test_half_a_pixel_or_half_a_place_is_refused(tmp_path):
    (tmp_path / "points.csv").write_text("u,v,lon,lat\n1,,27,53\n")
    with pytest.raises(GeoreferenceError, match="line 2: '' is not a usable number"):
        read_control_points(tmp_path / "points.csv")


@pytest.mark.parametrize("suffix", [".txt", ".points"])
def test_other_formats_leave_incomplete_points_out_with_a_warning(suffix):
    with pytest.warns(GeoaimWarning, match="left out: place only, pixel only"):
        text = format_points(make_points(INCOMPLETE), suffix)
    assert "27.0" in text
    assert "28.0" not in text
    with pytest.raises(GeoreferenceError, match="both a pixel and a place"):
        format_points(make_points(INCOMPLETE[1:]), suffix)


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "gcp_list.txt"
    path.write_text("old")
    with pytest.raises(GeoreferenceError):
        write_control_points(make_points([((1.0, 2.0), (5.0, 6.0), "a", None)], None), path)
    assert path.read_text() == "old"
    with pytest.raises(ValueError, match=r"must end in \.csv, \.txt, \.points"):
        write_control_points(make_points(INCOMPLETE), tmp_path / "points.xyz")
