import numpy as np
import pytest
from pyproj import Transformer

from benchmarks.synthetic.imagery import (
    TILE,
    cut_tiles,
    draw_offset,
    georeference_photo,
    make_other_day,
    photograph,
)
from benchmarks.synthetic.place import make_place, plan_from_image
from geoaim.base.geometry import transform_points
from geoaim.imagery.tiles import MERCATOR
from geoaim.tracks.tracks import Tracks


@pytest.fixture(scope="module")
def place():
    return make_place(8, kind="roundabout")


@pytest.fixture(scope="module")
def photo(place):
    states, present = np.empty((0, 1, 4)), np.empty((0, 1), bool)
    no_agents = Tracks(np.zeros(1), states, present, np.empty((0, 2)), (), (), place.world)
    return photograph(
        place, make_other_day(place), no_agents, sensor_resolution=0.4, resolution=0.2
    )


def _middle_in(place, crs):
    """The middle of the roundabout in some CRS, by pyproj alone."""
    east, north = np.array([180.0, 240.0]) + place.world.origin
    transformer = Transformer.from_crs(place.world.crs, crs, always_xy=True)
    return np.array(transformer.transform(east, north))


def _in_world(place, points, crs):
    """Places of a CRS in metres of the place's own, by pyproj alone."""
    moved = Transformer.from_crs(crs, place.world.crs, always_xy=True).transform(*points.T)
    return np.stack(moved, axis=1)


@pytest.mark.parametrize("crs", ["EPSG:3035", MERCATOR])
def test_imagery_is_misplaced_by_just_its_offset(place, photo, crs):
    offset = (3.0, -4.0)
    imagery = georeference_photo(place, photo, crs, offset=offset)
    straight = georeference_photo(place, photo, crs, offset=(0.0, 0.0))
    np.testing.assert_array_equal(imagery.image, straight.image)
    pixels = np.array([[100.0, 80.0], [300.0, 200.0], [200.0, 350.0]])
    places = (transform_points(i.crs_from_image, pixels) for i in (imagery, straight))
    shown, true = (_in_world(place, points, crs) for points in places)
    np.testing.assert_allclose(shown - true, [offset] * 3, atol=0.02)


@pytest.mark.parametrize("crs", ["EPSG:3035", MERCATOR, "EPSG:32635"])
def test_middle_of_the_place_lies_where_the_crs_has_it(place, photo, crs):
    imagery = georeference_photo(place, photo, crs, offset=(0.0, 0.0))
    pixel = transform_points(np.linalg.inv(imagery.crs_from_image), _middle_in(place, crs)[None])[0]
    grey = imagery.image[int(pixel[1]), int(pixel[0])].astype(int)
    assert grey[1] > grey[2]  # grass in the middle of the ring
    centre = transform_points(np.linalg.inv(plan_from_image(0.4)), np.zeros((1, 2)))[0].astype(int)
    window = photo[centre[1] - 3 : centre[1] + 4, centre[0] - 3 : centre[0] + 4].mean(axis=(0, 1))
    v, u = int(pixel[1]), int(pixel[0])
    shown = imagery.image[v - 3 : v + 4, u - 3 : u + 4].mean(axis=(0, 1))
    np.testing.assert_allclose(shown, window, atol=6)


def test_what_lies_outside_is_not_covered(place, photo):
    imagery = georeference_photo(place, photo, "EPSG:3035", offset=(0.0, 0.0))
    assert 0.2 < imagery.covered.mean() < 1.0
    assert not imagery.image[~imagery.covered].any()


def test_tiles_continue_each_other(place, photo):
    web = georeference_photo(place, photo, MERCATOR, offset=(0.0, 0.0))
    tiles = {(column, row): tile for column, row, tile in cut_tiles(web, 19)}
    pairs = [(k, (k[0] + 1, k[1])) for k in tiles if (k[0] + 1, k[1]) in tiles]
    seams, inside = [], []
    for here, beside in pairs:
        left, right = tiles[here].astype(int), tiles[beside].astype(int)
        seams.append(np.abs(left[:, -1] - right[:, 0]).mean())
        inside.append(np.abs(np.diff(left, axis=1)).mean())
    assert np.mean(seams) < 2 * np.mean(inside)
    assert min(tile.min(axis=-1).min() for tile in tiles.values()) > 0  # no black rims
    assert all(tile.shape == (TILE, TILE, 3) for tile in tiles.values())


def test_offset_is_some_metres_and_that_of_the_seed(place):
    offset = draw_offset(place)
    assert 2.0 <= np.hypot(*offset) <= 6.1
    assert offset == draw_offset(place)
    assert offset != draw_offset(make_place(9, kind="roundabout"))


def test_another_day_is_another_season():
    seasons = {make_other_day(make_place(seed, kind="street")).season for seed in range(6)}
    assert "summer" not in seasons
    assert len(seasons) > 1
