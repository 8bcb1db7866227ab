import numpy as np
import pytest

from benchmarks.georeference import benchmark as georeference_results
from benchmarks.georeference.methods import RIVALS, fit_rival, measure_row
from benchmarks.georeference.models import fit_georeferences
from benchmarks.georeference.simulated_points import (
    CAMERAS,
    LAYOUTS,
    NOISES,
    draw_sets,
    pick_points,
)
from geoaim.base.progress import no_progress
from geoaim.mapping.georeference.control_points import ControlPoints

pytestmark = pytest.mark.slow


@pytest.mark.filterwarnings("ignore::geoaim.base.errors.GeoaimWarning")
@pytest.mark.parametrize("noise", NOISES)
def test_most_corners_lie_in_the_stated_region(noise):
    row = measure_row(noise, 8, trials=14, seed=3)
    assert row["inside stated 95 %, %"] >= 85.0
    assert row["refused, %"] < 20.0


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_homography_finds_the_middle_of_each_camera_without_noise(camera):
    generator = np.random.default_rng(1)
    transform, resolution = camera(generator)
    pixels = generator.uniform((0, 0), (1920, 1080), (8, 2))
    names = tuple("abcdefgh")
    points = ControlPoints(pixels, transform(pixels), None, names, (None,) * 8)
    places = np.array([[960.0, 540.0]])
    found = fit_rival(RIVALS[0], points, places)
    assert np.linalg.norm(found - transform(places)) < 10 * resolution


def test_the_chosen_model_is_one_of_the_fitted():
    generator = np.random.default_rng(1)
    one = pick_points(CAMERAS[1](generator), LAYOUTS[0], "normal", (9, 1.0), generator)
    found = fit_georeferences(one.points)
    assert list(found) == ["similarity", "homography", "geoaim"]
    chosen, same = found["geoaim"], found[found["geoaim"].model]
    np.testing.assert_allclose(chosen.world_from_image, same.world_from_image)
    assert abs(found["similarity"].world_from_image[2, :2]).max() < 1e-12


def test_sets_of_the_same_seed_are_the_same():
    one, other = (draw_sets("heavy tails", 5, 2, seed=4) for _ in range(2))
    np.testing.assert_array_equal(one[1].points.pixels, other[1].points.pixels)


def test_the_benchmark_has_tables_and_charts(monkeypatch):
    monkeypatch.setattr(georeference_results, "QUICK_COUNTS", (6, 8))
    monkeypatch.setattr(georeference_results, "QUICK_TRIALS", 4)
    monkeypatch.setattr(georeference_results, "CASES", georeference_results.CASES[:9])
    results = georeference_results.measure_georeference(True, no_progress)
    assert len(results.tables["rows"]) == 2 * len(NOISES)
    assert {row["setting"] for row in results.tables["defaults"]} == {"control points", "terms"}
    assert list(results.charts) == ["fronts", "sizes", "regions"]
