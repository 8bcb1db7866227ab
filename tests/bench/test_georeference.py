import numpy as np
import pytest

from geoaim.bench import georeference
from geoaim.bench.georeference import CAMERAS, NOISES, RIVALS, fit_rival, main, measure_row


@pytest.mark.filterwarnings("ignore::geoaim.errors.GeoaimWarning")
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
    places = np.array([[960.0, 540.0]])
    found = fit_rival(RIVALS[0], pixels, transform(pixels), places)
    assert np.linalg.norm(found - transform(places)) < 10 * resolution


def test_the_command_writes_json_and_a_chart(monkeypatch, tmp_path):
    monkeypatch.setattr(georeference, "POINT_COUNTS", (8,))
    main(json=tmp_path / "rows.json", chart=tmp_path / "chart.png", trials=2, seed=3)
    assert all((tmp_path / name).stat().st_size > 300 for name in ("rows.json", "chart.png"))
