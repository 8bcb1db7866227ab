import numpy as np
import pytest

from benchmarks.hover_videos import film_ground
from benchmarks.registration import settings as registration_settings
from benchmarks.registration.settings import (
    Setting,
    measure_error,
    measure_models,
    measure_sizes,
    register_with,
)
from benchmarks.synthetic import Hover
from benchmarks.synthetic.scenery.texture import make_natural_noise
from geoaim.base.progress import no_progress
from geoaim.mapping.registration import patches
from geoaim.mapping.video.video import open_video

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def ground():
    field = make_natural_noise((540, 960), 1.2, np.random.default_rng(0))
    grey = (110 + 30 * field).clip(0, 255).astype(np.uint8)
    return np.dstack([grey] * 3)


@pytest.fixture(scope="module")
def video(ground):
    hover = Hover(count=5, drift=12, perspective=3, blur=0.3)
    return film_ground(np.repeat(np.repeat(ground, 3, 0), 3, 1), hover, seed=0)


@pytest.fixture(scope="module")
def frames(video):
    return list(open_video(list(video)))


def test_a_setting_changes_the_number_and_the_side_of_the_patches(frames):
    few = register_with(frames, Setting(count=85, side=9)).reference.keyframe.fine
    many = register_with(frames, Setting()).reference.keyframe.fine
    assert len(few.points) < 0.5 * len(many.points)
    assert few.contrast.shape[1:] == (9 * 9,)
    assert (Setting.count, Setting.side) == (patches.PATCH_COUNT, patches.PATCH_SIDE_PX)


@pytest.mark.parametrize(
    ("setting", "limit"), [(Setting(), 0.1), (Setting(reduction=2), 0.3), (Setting(count=85), 0.2)]
)
def test_settings_register_in_pixels_of_the_full_image(video, frames, setting, limit):
    assert measure_error(register_with(frames, setting), video) < limit


def test_rejected_frames_have_an_infinite_error(video, frames):
    blank = [*frames[:-1], next(iter(open_video([np.zeros((720, 1280), np.uint8)])))]
    assert measure_error(register_with(blank, Setting(model="similarity")), video) == np.inf


def test_sizes_have_one_default_each(video, monkeypatch):
    few = {
        name: dict(list(sizes.items())[-2:])
        for name, sizes in registration_settings.SETTINGS.items()
    }
    few["patches"] = {85: Setting(count=85), 340: Setting()}
    few["patch side, px"] = {9: Setting(side=9), 13: Setting()}
    monkeypatch.setattr(registration_settings, "SETTINGS", few)
    rows = measure_sizes([video], no_progress)
    for name in few:
        assert sum(row["default"] for row in rows if row["setting"] == name) == 1
    assert [row["size"] for row in rows if row["automatic"]] == [8]


def test_models_are_compared_in_cases_of_a_camera(monkeypatch, ground):
    monkeypatch.setattr(
        registration_settings, "draw_place", lambda *_, **__: np.tile(ground, (2, 2, 1))
    )
    monkeypatch.setattr(registration_settings, "CASES", registration_settings.CASES[:1])
    [case] = measure_models(quick=False)
    assert case["size"] == 2  # without tilt and turn a translation is enough
    assert min(case["errors"]) > 0
