import numpy as np
import pytest

from geoaim.base.errors import AimError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.grid import Grid, fit_affine, make_north_up_grid, pad_grid
from geoaim.base.world import LONLAT, World, crs_from_world

POINTS = np.array([[-3.0, 1.2], [7.1, 4.0]])
OBLIQUE = np.array([[0.05, 0.01, 3.7], [0.004, -0.05, 21.3], [2e-4, 4e-4, 1.0]])


def test_north_up_grid_covers_the_points_on_whole_multiples():
    grid = make_north_up_grid(POINTS, 0.5, World(None))
    assert grid.shape == (grid.height, grid.width) == (6, 21)
    np.testing.assert_array_equal(grid.corners, [[-3, 4], [7.5, 4], [7.5, 1], [-3, 1]])
    assert grid.resolution == 0.5
    assert grid.world == World(None)
    np.testing.assert_allclose(grid.grid_from_world @ [-3, 4, 1], [0, 0, 1], atol=1e-12)


def test_resolution_is_that_of_the_ground_in_the_middle():
    turned = Grid((300, 400), np.array([[0.2, 0.1, 5.0], [0.1, -0.2, 75], [0, 0, 1.0]]))
    assert turned.resolution == pytest.approx(np.sqrt(0.05))
    oblique = Grid((300, 400), OBLIQUE)
    square = image_corners(1, 1) + np.array([199.5, 149.5])
    (a, b, c, _) = transform_points(OBLIQUE, square)
    area = abs(np.linalg.det([b - a, c - b]))
    assert oblique.resolution == pytest.approx(np.sqrt(area), rel=1e-3)


def test_padded_grid_keeps_the_place_of_its_pixels():
    grid = make_north_up_grid(POINTS, 0.5)
    padded = pad_grid(grid, 3)
    assert padded.shape == (12, 27)
    np.testing.assert_allclose(padded.world_from_grid @ [3, 3, 1], grid.world_from_grid @ [0, 0, 1])


def test_too_many_pixels_and_no_resolution_are_refused():
    with pytest.raises(AimError, match=r"101000 pixels .* use a resolution of 0\.0004 m"):
        make_north_up_grid(POINTS, 1e-4)
    for resolution in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="positive number of metres"):
            make_north_up_grid(POINTS, resolution)


def test_affine_fit_lies_within_the_error_that_it_states():
    world = World("EPSG:32635", (500_000.0, 5_970_000.0))
    to_world = np.array([[0.0, 5.0, 7.0], [-5.0, 0.0, 3.0], [0.0, 0.0, 1.0]])  # turned by 90°
    grid = Grid((3000, 2000), to_world, world)
    matrix, error = fit_affine(grid, world, LONLAT)
    corners = np.array([[0.0, 0.0], [2000.0, 0.0], [2000.0, 3000.0], [0.0, 3000.0]])
    lonlat = crs_from_world(world, transform_points(to_world, corners), LONLAT)
    back = transform_points(np.linalg.inv(matrix), lonlat)
    assert np.abs(back - corners).max() == pytest.approx(error, rel=1e-3)
    assert 0.1 < error < 10
    exact, none = fit_affine(grid, world, "EPSG:32635")
    np.testing.assert_allclose(exact[:2, 2], [500_007.0, 5_970_003.0], atol=1e-6)
    assert none < 1e-6
