import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geoaim.base.errors import GeoaimWarning, GeoreferenceError
from geoaim.base.world import (
    World,
    choose_world,
    crs_from_world,
    describe_misplacement,
    find_operation,
    find_utm_crs,
    is_in_area,
    lonlat_from_world,
    warn_of_operation,
    world_from_crs,
    world_from_lonlat,
)

PLACES = st.tuples(st.floats(-179.9, 179.9), st.floats(-79.0, 83.0))


@given(PLACES, st.floats(-2e3, 2e3), st.floats(-2e3, 2e3))
def test_world_to_lonlat_and_back_is_exact_to_a_micrometre(place, x, y):
    world = choose_world(np.array([place]))
    points = np.array([[x, y], [0.0, 0.0]])
    back = world_from_lonlat(world, lonlat_from_world(world, points))
    np.testing.assert_allclose(back, points, rtol=0.0, atol=1e-6)


@given(st.floats(126.0, 128.0), st.floats(36.0, 38.5))
def test_another_crs_and_back_is_exact_to_a_micrometre(longitude, latitude):
    world = choose_world(np.array([[longitude, latitude]]))
    korean = crs_from_world(world, np.array([[3.0, 4.0]]), "EPSG:5186")
    back = world_from_crs(world, korean, "EPSG:5186")
    np.testing.assert_allclose(back, [[3.0, 4.0]], rtol=0.0, atol=1e-6)


@given(PLACES)
def test_the_origin_is_round_and_near(place):
    world = choose_world(np.array([place]))
    assert np.abs(world_from_lonlat(world, np.array([place]))).max() <= 51.0
    assert np.mod(world.origin, 100.0).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("longitude", "latitude", "crs"),
    [(27.56, 53.9, "EPSG:32635"), (-119.9, 34.4, "EPSG:32611"), (115.2, -8.5, "EPSG:32750"),
     (180.0, 10.0, "EPSG:32601"), (-180.0, 10.0, "EPSG:32601")],
)  # fmt: skip
def test_utm_zone_of_known_places(longitude, latitude, crs):
    assert find_utm_crs(longitude, latitude) == crs


@pytest.mark.parametrize("origin", [(1.0, 2.0, 3.0), (1.0,), (1.0, np.nan)])
def test_an_origin_of_other_than_two_finite_numbers_is_refused(unchecked, origin):
    with pytest.raises(GeoreferenceError, match="two finite numbers"):
        World(None, origin)


def test_places_on_both_sides_of_the_date_line_share_a_world():
    world = choose_world(np.array([[179.9999, 10.0], [-179.9999, 10.0]]))
    near = world_from_lonlat(world, np.array([[179.9999, 10.0], [-179.9999, 10.0]]))
    assert np.abs(near).max() < 200.0


def test_a_known_point_of_the_korean_grid():
    world = World("EPSG:5186", (170000.0, 532000.0))
    given = world_from_lonlat(world, np.array([[126.6635021, 37.3893296]]))
    np.testing.assert_allclose(given, [[201.12, 274.39]], atol=0.02)


@pytest.mark.parametrize(
    ("crs", "message"),
    [("EPSG:4326", "not projected"), ("EPSG:2992", "foot"), ("EPSG:3857", "times a metre"),
     ("EPSG:2053", "axes towards"), ("nonsense", "not a known coordinate")],
)  # fmt: skip
def test_a_crs_that_is_not_a_metric_plane_is_refused(crs, message):
    with pytest.raises(GeoreferenceError, match=message):
        World(crs, (3000000.0, 7000000.0) if crs == "EPSG:3857" else (0.0, 0.0))


def test_the_refusal_names_the_utm_zone_to_use():
    with pytest.raises(GeoreferenceError, match="EPSG:326"):
        World("EPSG:2992")


PLACE = np.array([[583185.9, 6062185.3]])


@pytest.mark.parametrize(
    ("points", "origin", "question"),
    [
        (PLACE, (583000.0, 6062000.0), "are x and y absolute"),
        (PLACE[:, ::-1], (0.0, 0.0), "are x and y swapped"),
        (PLACE / 0.3048, (0.0, 0.0), "are they feet"),
        (PLACE * [1, 9], (0.0, 0.0), "the CRS the right one"),
    ],
)
def test_places_outside_the_area_of_their_crs_are_described(points, origin, question):
    assert describe_misplacement("EPSG:32635", PLACE) == ""
    assert f"{question}?" in describe_misplacement("EPSG:32635", points, origin)


@pytest.mark.parametrize(
    ("crs", "lonlat"),
    [
        ("EPSG:4326", [200.0, 10.0]),  # longitudes from 0 to 360
        ("EPSG:2193", [-179.0, -44.0]),  # New Zealand, beyond the date line
        ("EPSG:32635", [32.0, 54.0]),  # two degrees beyond the zone
    ],
)
def test_areas_have_a_margin_and_go_round_the_earth(crs, lonlat):
    assert is_in_area(crs, np.array([lonlat]))


def test_swapped_latitude_is_named():
    with pytest.raises(GeoreferenceError, match="swapped"):
        choose_world(np.array([[34.4, -119.9]]))


def test_a_world_without_a_crs_has_no_longitude():
    with pytest.raises(GeoreferenceError, match="local plane"):
        lonlat_from_world(World(None), np.zeros((1, 2)))


def test_a_point_beyond_the_projection_is_refused():
    with pytest.raises(GeoreferenceError, match="cannot be expressed"):
        world_from_lonlat(World("EPSG:32635", (500000.0, 0.0)), np.array([[27.0, 120.0]]))


@pytest.mark.parametrize(
    ("source", "destination", "accuracy"),
    [("EPSG:4326", "EPSG:32635", 0.0), ("EPSG:4284", "EPSG:32635", 3.0)],
)
def test_the_accuracy_of_a_transformation_is_that_of_proj(source, destination, accuracy):
    found = find_operation(source, destination, np.array([[28.0, 54.0]]))
    assert (found.accuracy, found.better) == (accuracy, "")


def test_a_better_transformation_that_lacks_its_grid_is_named():
    found = find_operation("EPSG:27700", "EPSG:32630", np.array([[530_000.0, 180_000.0]]))
    if not found.better:
        pytest.skip("the grids of Great Britain are installed")
    assert found.accuracy == 2.0
    with pytest.warns(GeoaimWarning, match=r"with 2 m, since .* needs .*OSTN15.*pyproj sync"):
        warn_of_operation(found, "EPSG:27700", "EPSG:32630")
