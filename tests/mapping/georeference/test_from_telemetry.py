import numpy as np
import pytest

from geoaim.base.errors import GeoreferenceError
from geoaim.base.geometry import image_corners
from geoaim.base.world import World, world_from_lonlat
from geoaim.mapping.georeference.from_telemetry import (
    approximate_georeference,
    make_local_georeference,
)
from geoaim.mapping.georeference.georeference import world_from_pixels
from geoaim.mapping.georeference.uncertainty import predict_uncertainty
from tests.mapping.georeference.points import HEIGHT, SIZE, WIDTH


def test_telemetry_looking_straight_down_gives_an_approximate_georeference():
    result = approximate_georeference(
        latitude=53.9, longitude=27.56, height_above_ground=100.0, yaw=np.pi / 2.0,
        field_of_view=np.radians(73.7), size=(HEIGHT, WIDTH),
    )  # fmt: skip
    assert result.approximate
    centre, top = world_from_pixels(result, np.array([[960.0, 540.0], [960.0, 0.0]]))
    there = world_from_lonlat(result.world, np.array([[27.56, 53.9]]))[0]
    np.testing.assert_allclose(centre, there, atol=1e-6)
    east, north = top - centre
    assert north == pytest.approx(540 * 150.0 / 1920, rel=0.01)
    assert abs(east) < 0.05 * north
    sigma, _ = predict_uncertainty(result, image_corners(**SIZE))
    assert 6.0 < sigma.min() <= sigma.max() < 15.0
    with pytest.raises(GeoreferenceError, match="does not fix a place"):
        approximate_georeference(latitude=np.nan, longitude=0, height_above_ground=1, yaw=0,
                                 field_of_view=1, size=(1, 1))  # fmt: skip


def test_a_local_georeference_has_its_origin_at_the_corner_unless_said():
    result, centred = (
        make_local_georeference(resolution=0.1, size=(HEIGHT, WIDTH), **origin)
        for origin in ({}, {"origin": (WIDTH / 2, HEIGHT / 2)})
    )
    pixels = np.array([[0.0, 0.0], [WIDTH, HEIGHT]])
    np.testing.assert_allclose(world_from_pixels(result, pixels), [[0, 0], [192, -108]], atol=1e-9)
    np.testing.assert_allclose(world_from_pixels(centred, pixels), [[-96, 54], [96, -54]])
    assert result.world == World(None)
