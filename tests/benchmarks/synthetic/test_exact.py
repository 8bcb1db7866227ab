import hashlib
import os
import subprocess
import sys

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.synthetic.exact import blur, pack, premultiply, round_reproducibly, warp
from geoaim.base.geometry import to_opencv

# what a whole made place hashes to, on every machine that adds and multiplies as IEEE 754 says
MADE = """
import hashlib, numpy as np
from benchmarks.synthetic import Hover, make_sample, render_frame, tracks_of
sample = make_sample(4, minutes=0.2, video=(180, 320), hover=Hover(count=20, frame_rate=2.0),
                     resolution=0.2)
digest = hashlib.sha256()
tracks = tracks_of(sample)
digest.update(np.round(tracks.states[tracks.present], 6).tobytes())
digest.update(render_frame(sample.clip, 7).tobytes())
print(digest.hexdigest())
"""
PLAIN = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FP16,AVX,FMA3",
    "OPENBLAS_CORETYPE": "Nehalem",
    "OPENCV_IPP": "disabled",
    "OMP_NUM_THREADS": "1",
}


def _image(seed=0, shape=(40, 60, 3)):
    noise = np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 1.5))


@given(st.floats(-1e6, 1e6))
def test_rounded_numbers_change_little_and_only_once(value):
    once = round_reproducibly(np.array([value]))
    assert abs(once[0] - value) <= 0.5 / 2**20
    np.testing.assert_array_equal(round_reproducibly(once), once)


def test_numbers_that_differ_in_the_last_bit_are_rounded_to_one():
    assert round_reproducibly(np.array([0.1 + 0.2])) == round_reproducibly(np.array([0.3]))


def test_identity_warps_to_the_same_picture():
    image = _image()
    np.testing.assert_array_equal(warp(pack(image), np.eye(3), 40, 60), image)


def test_whole_shift_moves_pixels_and_the_rim_goes_on():
    image = _image()
    moved = warp(pack(image), np.array([[1.0, 0, -5], [0, 1, 0], [0, 0, 1]]), 40, 60)
    np.testing.assert_array_equal(moved[:, 5:], image[:, :-5])
    np.testing.assert_array_equal(moved[:, 0], image[:, 0])


@pytest.mark.parametrize("tilt", [0.0, 1e-4])
def test_warp_is_linear_interpolation(tilt):
    image = _image()
    matrix = np.array([[0.9, 0.1, 3.3], [-0.1, 0.95, 5.2], [tilt, 2 * tilt, 1]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    wanted = cv2.warpPerspective(image, to_opencv(matrix), (40, 25), flags=flags)
    found = warp(pack(image), matrix, 25, 40)
    assert np.abs(found.astype(int) - wanted).max() <= 1
    # OpenCV 4 rounds positions to 1/32 px
    assert np.abs(found.astype(float) - wanted).mean() < 0.1


def test_single_channel_comes_back_in_the_first():
    alpha = _image(shape=(30, 30, 1)).reshape(30, 30, 1)
    np.testing.assert_array_equal(warp(pack(alpha), np.eye(3), 30, 30)[..., :1], alpha)


def test_premultiplied_clear_pixels_are_black():
    sprite = np.full((4, 4, 4), 200, np.uint8)
    sprite[..., 3] = [0, 255, 128, 0]
    light = premultiply(sprite)
    assert light.shape == (6, 6, 4)
    assert light[1:5, 2, :3].tolist() == [[200] * 3] * 4
    assert light[1:5, 3, 0].tolist() == [100] * 4
    assert not light[:, [0, 1, 4, 5]].any()


def test_blur_without_width_changes_nothing():
    image = _image()
    assert blur(image, 0.0) is image


@pytest.mark.slow
def test_made_place_is_the_same_on_a_machine_without_vector_instructions():
    command, options = [sys.executable, "-W", "ignore", "-c", MADE], {"check": True, "text": True}
    results = [
        subprocess.run(command, env=os.environ | settings, capture_output=True, **options)
        for settings in ({}, PLAIN)
    ]
    found = [result.stdout.strip() for result in results]
    assert len(found[0]) == len(hashlib.sha256().hexdigest())
    assert found[0] == found[1]
