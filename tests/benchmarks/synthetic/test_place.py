from dataclasses import replace

import numpy as np
import pytest
import shapely

from benchmarks.synthetic import Day, draw_place, make_place
from benchmarks.synthetic.place import plan_from_image
from benchmarks.synthetic.roads.markings import make_markings
from benchmarks.synthetic.scenery.canvas import make_canvas
from geoaim.base.geometry import transform_points
from tests.sizes import keep_quick

COARSE = 0.2


@pytest.fixture(scope="module", params=keep_quick(["junction", "roundabout"], "junction"))
def place(request):
    return make_place(6, kind=request.param)


@pytest.fixture(scope="module")
def picture(place):
    return draw_place(place, resolution=COARSE)


def _grey_at(picture, points):
    pixels = transform_points(np.linalg.inv(plan_from_image(COARSE)), points).astype(int)
    inside = (pixels >= 0).all(axis=1) & (pixels < picture.shape[1::-1]).all(axis=1)
    return picture[pixels[inside, 1], pixels[inside, 0]].mean(axis=-1)


@pytest.mark.parametrize("metres", [0.05, 0.06, 0.07, 0.15, 0.2])
def test_drawn_and_told_places_of_pixels_agree(metres):
    canvas = make_canvas(metres, np.random.default_rng(0))
    product = plan_from_image(metres) @ canvas.image_from_plan
    np.testing.assert_allclose(product, np.eye(3), atol=1e-9)


def test_picture_has_the_pages_size(picture):
    assert picture.shape == (520, 880, 3)


def test_same_seed_gives_the_same_picture(place, picture):
    again = make_place(6, kind=place.roads.layout.kind)
    np.testing.assert_array_equal(draw_place(again, resolution=COARSE), picture)
    other = make_place(7, kind=place.roads.layout.kind)
    assert not np.array_equal(draw_place(other, resolution=COARSE), picture)


def test_paint_is_bright_where_the_plan_has_it(place, picture):
    shapes = [shapely.Polygon(p) for p in make_markings(place.roads)]
    wide = [shape for shape in shapes if shape.area > 1.0 and place.roads.extent.contains(shape)]
    middles = np.array([shape.centroid.coords[0] for shape in wide])
    lanes = np.concatenate([lane.centreline for lane in place.roads.lanes])
    assert np.median(_grey_at(picture, middles)) > np.median(_grey_at(picture, lanes)) + 50


def test_grass_is_green_and_tar_is_grey(place, picture):
    green = [p for p in place.scenery.parcels if p.use in ("field", "park")]
    if not green:
        pytest.skip("no field in the picture")
    field = max(green, key=lambda parcel: parcel.area.area)
    spot = np.array(field.area.representative_point().coords)
    pixel = transform_points(np.linalg.inv(plan_from_image(COARSE)), spot)[0].astype(int)
    window = picture[pixel[1] - 4 : pixel[1] + 5, pixel[0] - 4 : pixel[0] + 5].mean(axis=(0, 1))
    assert window[1] > window[2]


def test_another_day_has_other_cars_and_shadows_on_the_same_ground(place, picture):
    day = Day("winter", azimuth=0.5, elevation=0.6, number=3, changes=6)
    later = draw_place(place, day, resolution=COARSE)
    assert np.abs(later.astype(int) - picture).mean() > 10
    changed = draw_place(place, replace(day, changes=0), resolution=COARSE)
    assert not np.array_equal(changed, later)


def test_clouds_take_the_shadows():
    place = make_place(6, kind="street")
    days = Day(clouds=0.0), Day(clouds=1.0)
    sunny, cloudy = (draw_place(place, day, resolution=COARSE) for day in days)
    gain = cloudy.mean(axis=-1) / np.maximum(sunny.mean(axis=-1), 1)
    assert np.percentile(gain, 97) > 1.5 * np.median(gain)


def test_nothing_stands_on_the_roads(place):
    road = shapely.union_all([place.roads.paving.carriageway, place.roads.paving.driveway])
    for building in place.scenery.buildings:
        assert road.distance(shapely.Point(building.centre)) > 3
    for tree in place.scenery.trees:
        assert road.distance(shapely.Point(tree.place)) > 0


def test_unknown_kind_is_refused(unchecked):
    with pytest.raises(ValueError, match="kind 'lane' is not one of"):
        make_place(1, kind="lane")  # type: ignore[arg-type]
