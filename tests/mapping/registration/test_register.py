from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.camera import reference_from_frames, render_frame
from geoaim.base.errors import RegistrationError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.mapping.registration.features import detect_features, match_features
from geoaim.mapping.registration.patches import align_patches, make_template, predict_uncertainty
from geoaim.mapping.registration.register import (
    choose_reference,
    collect_registration,
    register,
    register_frames,
)
from geoaim.mapping.video.video import open_video
from tests.conftest import textured


def corner_error(matrix, truth, clip):
    corners = image_corners(clip.height, clip.width)
    apart = transform_points(matrix, corners) - transform_points(truth, corners)
    return np.linalg.norm(apart, axis=-1).mean(-1)


@pytest.fixture(scope="module")
def frames(clip):
    return [render_frame(clip, index) for index in range(len(clip.times))]


@pytest.fixture(scope="module")
def registration(frames):
    return register(frames)


def test_every_frame_lies_where_the_truth_says(registration, clip):
    index = registration.reference.index
    truth = reference_from_frames(clip, index)
    errors = corner_error(registration.reference_from_frame, truth, clip)
    assert registration.valid.all()
    assert errors.mean() < 0.1


def test_stated_uncertainty_is_of_the_size_of_the_error(registration, clip):
    truth = reference_from_frames(clip, registration.reference.index)
    errors = corner_error(registration.reference_from_frame, truth, clip)
    others = errors > 1e-6
    ratio = np.median(errors[others]) / np.median(registration.uncertainty[others])
    assert 0.3 < ratio < 2


def test_no_frame_states_much_less_than_the_others(frames):
    video = open_video(frames)
    reference = choose_reference(video)
    done = register_frames(video, reference)
    rows = [(f.index, f.time, replace(placed, uncertainty=1.0)) for f, placed in done]
    rows[1] = (*rows[1][:2], replace(rows[1][2], uncertainty=0.02))
    assert collect_registration(rows, reference).uncertainty[1] == pytest.approx(0.75)


def test_table_has_a_row_a_frame_and_its_matrix(registration, frames):
    table = registration.to_dataframe()
    assert len(table) == len(frames)
    np.testing.assert_allclose(table.m22, 1)


def test_noise_in_place_of_a_frame_is_rejected_and_the_rest_is_not(frames, clip):
    spoilt = list(frames)
    spoilt[5] = np.random.default_rng(0).integers(0, 256, frames[5].shape).astype(np.uint8)
    registration = register(spoilt, reference_time=0)
    assert np.flatnonzero(~registration.valid).tolist() == [5]
    assert registration.reason[5]
    assert np.isnan(registration.reference_from_frame[5]).all()
    errors = corner_error(registration.reference_from_frame, reference_from_frames(clip, 0), clip)
    assert np.nanmax(errors) < 0.3


def test_frames_after_a_cut_to_another_place_are_rejected(frames):
    other = textured(np.random.default_rng(99), *frames[0].shape[:2])
    registration = register([*frames[:4], other, other], reference_time=0)
    assert registration.valid.tolist() == [True] * 4 + [False] * 2


def test_a_frame_upside_down_is_found(frames):
    turned = np.ascontiguousarray(frames[0][::-1, ::-1])
    registration = register([frames[0], turned], reference_time=0)
    height, width = turned.shape[:2]
    expected = np.array([[-1.0, 0, width], [0, -1, height], [0, 0, 1]])
    np.testing.assert_allclose(registration.reference_from_frame[1], expected, atol=0.02)


def test_gain_and_shadow_do_not_move_the_frame(frames, clip):
    shaded = (frames[6] * 0.6).astype(np.uint8)
    shaded[:, : clip.width // 2] = (shaded[:, : clip.width // 2] * 0.25).astype(np.uint8)
    registration = register([frames[0], shaded], reference_time=0)
    truth = reference_from_frames(clip, 0)[6]
    assert corner_error(registration.reference_from_frame[1], truth, clip) < 0.2


def test_a_blank_video_is_refused_with_what_it_lacks():
    with pytest.raises(RegistrationError, match="enough texture"):
        register([np.full((200, 300, 3), 90, np.uint8)] * 3)


def test_unrelated_frames_are_refused(frames):
    other = textured(np.random.default_rng(5), *frames[0].shape[:2])
    third = textured(np.random.default_rng(6), *frames[0].shape[:2])
    registration = register([frames[0], other, third], reference_time=0)
    assert registration.valid.tolist() == [True, False, False]


def test_a_flight_past_the_reference_is_chained_with_growing_uncertainty():
    ground = textured(np.random.default_rng(8), 400, 2000)
    steps = range(0, 1300, 60)
    frames = [ground[:, left : left + 500] for left in steps]
    registration = register(frames, reference_time=0)
    assert registration.valid.all()
    np.testing.assert_allclose(registration.reference_from_frame[:, 0, 2], list(steps), atol=0.3)
    assert registration.uncertainty[-1] > registration.uncertainty[1]


def test_patches_on_excluded_pixels_are_not_used(frames):
    grey = frames[0][..., 1]
    exclude = np.zeros(grey.shape, bool)
    exclude[:, :320] = True
    template = make_template(np.ascontiguousarray(grey), exclude=exclude)
    assert template.points[:, 0].min() > 320


def test_aligning_the_reference_with_itself_gives_the_identity(frames):
    grey = np.ascontiguousarray(frames[0][..., 1])
    template = make_template(grey)
    alignment = align_patches(template, grey, np.eye(3), "homography")
    np.testing.assert_allclose(alignment.matrix, np.eye(3), atol=1e-4)
    assert alignment.inliers[alignment.in_view].all()
    corners = image_corners(template.height, template.width)
    assert predict_uncertainty(template, alignment.motion, corners) < 0.1


def test_features_of_unlike_pictures_do_not_match(frames):
    other = textured(np.random.default_rng(11), *frames[0].shape[:2])
    one, two = detect_features(frames[0][..., 1].copy()), detect_features(other[..., 1].copy())
    assert match_features(one, two, "homography", size=(360, 640)) is None


def test_an_image_too_small_for_patches_is_refused():
    with pytest.raises(RegistrationError, match="enough texture"):
        register([textured(np.random.default_rng(1), 20, 20)] * 3)


@pytest.mark.parametrize(("height", "width"), [(60, 900), (100, 1900), (90, 100)])
def test_narrow_and_small_images_are_registered(height, width):
    image = textured(np.random.default_rng(1), height, width)
    assert register([image] * 3).valid.all()


def test_one_frame_that_jumps_is_rejected(frames):
    ground = textured(np.random.default_rng(4), 400, 700)
    lefts = [20, 22, 24, 26, 90, 30, 32, 34, 36]
    registration = register([ground[:, left : left + 500] for left in lefts], reference_time=0)
    assert np.flatnonzero(~registration.valid).tolist() == [4]
    assert "neighbours" in registration.reason[4]


@pytest.mark.slow
def test_a_view_that_swings_back_and_forth_makes_few_keyframes(frames):
    ground = textured(np.random.default_rng(4), 400, 1000)
    lefts = [0, 230, 20, 260] * 5
    views = [ground[:, left : left + 500] for left in lefts]
    reference = choose_reference(open_video(views), time=0)
    placed = [placement for _, placement in register_frames(open_video(views), reference)]
    assert all(placement.valid for placement in placed)


def test_probes_that_were_read_already_are_not_read_again(frames):
    video = open_video(frames)

    def refuse(*_):
        raise AssertionError("frames were read again")

    silent = replace(video, read_all=refuse, read_at=refuse)
    for time in (0.0, 3.0):
        reference = choose_reference(silent, time=time, probes=list(video))
        again = choose_reference(video, time=time)
        assert (reference.index, reference.model) == (again.index, again.model)


def test_a_given_time_and_model_leave_nothing_to_read_but_the_reference(frames):
    read = []

    def note(times, slack):
        read.append((times.tolist(), slack))
        return video.read_at(times, slack)

    video = open_video(frames)
    noted = replace(video, read_at=note)
    reference = choose_reference(noted, time=3.0, model="similarity")
    assert (reference.index, reference.model) == (3, "similarity")
    assert read == [([3.0], 0.0)]
