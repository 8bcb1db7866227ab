import numpy as np
import pytest

from geoaim.mapping.background.exposure import apply_gain, estimate_gain, start_exposure
from geoaim.mapping.video.video import open_video


def test_the_gain_of_a_much_darker_frame_is_estimated():
    generator = np.random.default_rng(0)
    light = generator.integers(150, 220, (240, 320), dtype=np.uint8)
    dark = (light * 0.2).astype(np.uint8)
    frames = list(open_video([light, dark]))
    exposure = start_exposure((240, 320))
    assert estimate_gain(exposure, frames[0], np.eye(3)) == pytest.approx(1)
    assert estimate_gain(exposure, frames[1], np.eye(3)) == pytest.approx(5, rel=0.05)


@pytest.mark.parametrize(("gain", "neutral"), [(1.5, 128), (1.5, 16), (0.7, 0), (1.013, 128)])
def test_a_gain_multiplies_the_distance_from_the_neutral_value(gain, neutral):
    pixels = np.arange(256, dtype=np.uint8)[None]
    expected = np.clip(pixels * gain + neutral * (1 - gain), 0, 255)
    assert np.abs(apply_gain(pixels, gain, neutral) - expected).max() <= 1  # rounding
