import numpy as np
import pytest

from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import transform_points
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.estimate import estimate_preliminary
from geoaim.web.picking.candidates import propose_pairs

PIXELS = np.array([[290.0, 340.0], [960.0, 390.0], [660.0, 710.0]])


def make_rough_georeference(place, seed, offset=(0.0, 0.0)):
    frame, imagery, matrix = place
    generator = np.random.default_rng(seed)
    places = transform_points(matrix, PIXELS) + generator.normal(0, 0.3, (3, 2)) + offset
    pixels = PIXELS + generator.normal(0, 2, (3, 2))
    points = ControlPoints(
        pixels, places + imagery.world.origin, imagery.world.crs, ("a", "b", "c"), (None,) * 3
    )
    height, width = frame.shape[:2]
    return estimate_preliminary(points, height=height, width=width, world=imagery.world)


def test_pairs_from_three_rough_points_are_right_and_spread(place):
    frame, imagery, matrix = place
    pairs = propose_pairs(frame, imagery, make_rough_georeference(place, 0))
    assert 8 <= len(pairs) <= 12
    pixels = np.array([pair.pixel for pair in pairs])
    errors = np.array([pair.place for pair in pairs]) - transform_points(matrix, pixels)
    assert np.linalg.norm(errors, axis=1).max() < 0.5
    assert np.sqrt(np.mean(errors**2)) < 2 * pairs[0].sigma_m
    assert (np.ptp(pixels, axis=0) > np.multiply(frame.shape[1::-1], 0.6)).all()
    distances = np.linalg.norm(pixels[:, None] - pixels, axis=2) + 1e9 * np.eye(len(pixels))
    assert distances.min() > 60


def test_a_frame_of_another_place_gives_no_pairs(place):
    _, imagery, _ = place
    other = np.random.default_rng(0).integers(0, 255, place[0].shape, np.uint8)
    with pytest.raises(AlignmentError):
        propose_pairs(other, imagery, make_rough_georeference(place, 0))
