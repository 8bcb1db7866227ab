from dataclasses import replace

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.camera import (
    Hover,
    SpriteTracks,
    film,
    list_boxed_agents,
    list_boxes,
    measure_traffic_share,
    reference_from_frames,
    render_background,
    render_frame,
    render_frames,
)
from benchmarks.synthetic.compositing import paste
from benchmarks.synthetic.scenery.texture import make_natural_noise
from geoaim.base.geometry import to_opencv, transform_points

QUIET = Hover(count=6, drift=6.0, noise=0.0, exposure=0.0, blur=0.8)


def _still(seed=0):
    field = make_natural_noise((300, 500), 1.0, np.random.default_rng(seed))
    return np.repeat((120 + 35 * field).clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)


def _traffic(count):
    sprite = np.zeros((16, 30, 4), np.uint8)
    sprite[3:-3, 3:-3] = [210, 20, 20, 255]
    poses = np.zeros((count, 2, 3))
    poses[:, 0] = [250, 150, 0.3]
    poses[:, 1] = np.stack([140 + 25 * np.arange(count), np.full(count, 80), np.zeros(count)], 1)
    return SpriteTracks((sprite, sprite), np.array([[24.0, 10.0]] * 2), poses)


def _clip(hover=QUIET, seed=0, **options):
    traffic = _traffic(hover.count)
    generator = np.random.default_rng(seed)
    traffic = replace(traffic, **options)
    return film(_still(), traffic, hover, height=200, width=360, generator=generator)


@pytest.mark.parametrize("index", [1, 5])
def test_frame_warped_by_the_truth_lies_on_the_reference(index):
    clip = _clip()
    matrix = to_opencv(reference_from_frames(clip)[index])
    frame, reference = render_frame(clip, index), render_background(clip)
    warped = cv2.warpPerspective(frame, matrix, (360, 200), flags=cv2.INTER_LANCZOS4)
    free = measure_traffic_share(clip) == 0
    free[:25], free[-25:], free[:, :25], free[:, -25:] = False, False, False, False
    difference = (warped[..., 0].astype(float) - reference[..., 0])[free]
    down, right = np.gradient(reference[..., 0].astype(float))
    slopes = np.stack([right[free], down[free]], axis=1)
    shift = np.linalg.lstsq(slopes, difference, rcond=None)[0]
    assert np.abs(shift).max() < 0.01  # px
    assert np.sqrt((difference**2).mean()) < 1.5  # grey levels


def test_reference_from_its_own_frame_is_the_identity():
    np.testing.assert_allclose(reference_from_frames(_clip(), 2)[2], np.eye(3), atol=1e-9)


def test_drift_is_the_mean_distance_of_the_centre():
    clip = _clip(replace(QUIET, vibration=0.0))
    centre = transform_points(clip.frame_from_background[0], np.array([[250.0, 150.0]]))
    moved = transform_points(clip.frame_from_background, np.array([[250.0, 150.0]]))[:, 0] - centre
    assert np.hypot(*moved.T).mean() == pytest.approx(6.0, rel=0.1)


def test_vehicles_lie_inside_their_boxes():
    clip = _clip(replace(QUIET, blur=0.0))
    for index in range(6):
        frame = render_frame(clip, index).astype(int)
        changed = np.abs(frame - render_background(clip, index)) > 12
        for left, top, right, bottom in list_boxes(clip, index):
            changed[int(top) : int(bottom) + 1, int(left) : int(right) + 1] = False
        assert not changed.any()


def test_share_of_traffic_is_one_where_a_car_stands_and_small_where_one_passes():
    clip = _clip()
    share = measure_traffic_share(clip)
    places = clip.traffic.poses[[0, 2], [0, 1], :2]
    (u, v), (x, y) = transform_points(clip.frame_from_background[0], places)
    assert share[int(v), int(u)] == 1.0
    assert 0 < share[int(y), int(x)] <= 0.5


def test_absent_vehicles_leave_no_trace():
    poses = _traffic(6).poses
    poses[:] = np.nan
    clip = _clip(poses=poses)
    assert len(list_boxes(clip, 0)) == 0
    np.testing.assert_array_equal(render_frame(clip, 3), render_background(clip, 3))


def test_shadow_darkens_beside_the_vehicle():
    clip = _clip(shadow=(0.0, 30.0))
    shaded = transform_points(clip.frame_from_background[0], np.array([[250.0, 180.0]]))[0]
    u, v = shaded.astype(int)
    assert render_frame(clip, 0)[v, u].mean() < 0.6 * render_background(clip, 0)[v, u].mean()


def test_same_seed_gives_the_same_frames():
    hover = replace(QUIET, noise=2.0, exposure=0.05)
    first, again, other = (list(render_frames(_clip(hover, seed))) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_traffic_of_another_length_is_refused():
    with pytest.raises(ValueError, match="5 steps and hover 6 frames"):
        film(
            _still(), _traffic(5), QUIET, height=200, width=360, generator=np.random.default_rng(0)
        )


def test_boxes_tell_whose_they_are():
    poses = _traffic(6).poses
    poses[:, 0] = np.nan
    numbers, boxes = list_boxed_agents(_clip(poses=poses), 0)
    assert numbers.tolist() == [1]
    assert boxes.shape == (1, 4)


def test_pasted_sprite_is_centred_at_its_pose_and_turned():
    image = np.zeros((60, 80, 3), np.uint8)
    paste(image, _traffic(1).sprites[:1], np.array([[40.0, 30.0, np.pi / 2]]))
    v, u = np.nonzero(image[..., 0] > 100)
    assert u.mean() + 0.5 == pytest.approx(40, abs=0.1)
    assert v.mean() + 0.5 == pytest.approx(30, abs=0.1)
    assert np.ptp(v) > 1.8 * np.ptp(u)


def test_sprite_beside_the_picture_is_left_out():
    image = np.zeros((20, 20, 3), np.uint8)
    paste(image, _traffic(1).sprites[:1], np.array([[-50.0, 10.0, 0.0]]))
    assert not image.any()
