import cv2
import numpy as np
import pytest

from geoaim.base.geometry import translation
from geoaim.mapping.registration.frame_registration import (
    Keyframe,
    compute_overlap,
    make_keyframe,
    register_frame,
    select_keyframe,
)
from tests.conftest import textured

GROUND = textured(np.random.default_rng(2), 240, 700)


def view(left: int) -> np.ndarray:
    return np.ascontiguousarray(GROUND[:, left : left + 400, 1])


@pytest.fixture(scope="module")
def keyframes() -> list[Keyframe]:
    return [make_keyframe(view(left), None, translation(left, 0), 0.0) for left in (0, 250)]


def test_overlap_falls_with_the_distance_from_the_keyframe(keyframes):
    shares = [compute_overlap(keyframes[0], translation(x, 0), (240, 400)) for x in (0, 200, 400)]
    assert shares[0] == 1
    assert 0.3 < shares[1] < 0.7
    assert shares[2] == 0


def test_earliest_keyframe_with_enough_overlap_is_selected(keyframes):
    assert select_keyframe(keyframes, translation(100, 0), (240, 400)) is keyframes[0]
    assert select_keyframe(keyframes, translation(280, 0), (240, 400)) is keyframes[1]


def test_frame_is_registered_to_the_reference_through_another_keyframe(keyframes):
    result, _ = register_frame(
        view(300), keyframes, keyframes[1], translation(296, 3), "translation"
    )
    assert result.valid
    np.testing.assert_allclose(result.reference_from_frame, translation(300, 0), atol=0.02)


def test_frame_far_from_the_prior_is_found_by_its_features(keyframes):
    result, _ = register_frame(view(60), keyframes, keyframes[1], np.eye(3), "translation")
    assert result.valid
    np.testing.assert_allclose(result.reference_from_frame, translation(60, 0), atol=0.02)


def test_parts_that_disagree_widen_the_statement(keyframes):
    frame = view(5).copy()
    calm, _ = register_frame(frame, keyframes[:1], keyframes[0], np.eye(3), "translation")
    frame[:, : frame.shape[1] // 2] = np.roll(frame, 1, axis=0)[:, : frame.shape[1] // 2]
    torn, _ = register_frame(frame, keyframes[:1], keyframes[0], np.eye(3), "translation")
    assert calm.uncertainty < 0.1
    assert not torn.valid or torn.uncertainty > 0.5


def test_blocks_that_compression_froze_widen_the_statement(keyframes):
    moved = view(5).copy()
    right = np.s_[:, 7 * moved.shape[1] // 10 :]
    moved[right] = np.rint(view(5)[right] * 0.5 + view(6)[right] * 0.5).astype(np.uint8)
    noise = np.random.default_rng(0).normal(0, 3, moved.shape)
    noisy = np.rint(moved + noise).clip(0, 255).astype(np.uint8)
    frozen, alive = (
        register_frame(frame, keyframes[:1], keyframes[0], np.eye(3), "translation")[0]
        for frame in (moved, noisy)
    )
    assert frozen.uncertainty > 1.2 * alive.uncertainty


@pytest.mark.parametrize("quality", [5, 10, 20])
def test_noise_of_each_patch_by_itself_hardly_misleads_the_rest(keyframes, quality):
    code = cv2.imencode(".jpg", view(5), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    coded = np.asarray(cv2.imdecode(code, cv2.IMREAD_GRAYSCALE), np.uint8)
    found, _ = register_frame(coded, keyframes[:1], keyframes[0], np.eye(3), "translation")
    error = np.hypot(*(found.reference_from_frame - translation(5, 0))[:2, 2])
    assert error < found.uncertainty < 11 * error  # 5.7 to 21 times before
