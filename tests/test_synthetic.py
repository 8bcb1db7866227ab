from dataclasses import replace

import av
import cv2
import numpy as np
import pytest

from geoaim.geometry import to_opencv, transform_points
from geoaim.mapping.telemetry import read_srt
from geoaim.synthetic import (
    Hover,
    Traffic,
    clean_frame,
    film,
    frame_boxes,
    hover_frames,
    make_sample,
    reference_from_frames,
    render_frame,
    traffic_share,
    write_scene,
)
from geoaim.synthetic.texture import natural_noise
from geoaim.world import lonlat_from_world, world_from_lonlat

QUIET = Hover(count=6, drift=6.0, noise=0.0, exposure=0.0, blur=0.8)
SMALL = Hover(count=25, frame_rate=2.0, drift=4.0, perspective=0.3)


def _still(seed=0):
    field = natural_noise((300, 500), 1.0, np.random.default_rng(seed))
    return np.repeat((120 + 35 * field).clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)


def _traffic(count):
    sprite = np.zeros((16, 30, 4), np.uint8)
    sprite[3:-3, 3:-3] = [210, 20, 20, 255]
    poses = np.zeros((count, 2, 3))
    poses[:, 0] = [250, 150, 0.3]
    poses[:, 1] = np.stack([140 + 25 * np.arange(count), np.full(count, 80), np.zeros(count)], 1)
    return Traffic((sprite, sprite), np.array([[24.0, 10.0]] * 2), poses)


def _clip(hover=QUIET, seed=0, **options):
    traffic = _traffic(hover.count)
    generator = np.random.default_rng(seed)
    return film(
        _still(), replace(traffic, **options), hover, height=200, width=360, generator=generator
    )


@pytest.fixture(scope="module")
def sample():
    return make_sample(3, hover=SMALL, height=180, width=320, metres_per_pixel=0.2)


@pytest.mark.parametrize("index", [1, 5])
def test_frame_warped_by_the_truth_lies_on_the_reference(index):
    clip = _clip()
    matrix = to_opencv(reference_from_frames(clip)[index])
    frame, reference = render_frame(clip, index), clean_frame(clip)
    warped = cv2.warpPerspective(frame, matrix, (360, 200), flags=cv2.INTER_LANCZOS4)
    free = traffic_share(clip) == 0
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
        changed = np.abs(render_frame(clip, index).astype(int) - clean_frame(clip, index)) > 12
        for left, top, right, bottom in frame_boxes(clip, index):
            changed[int(top) : int(bottom) + 1, int(left) : int(right) + 1] = False
        assert not changed.any()


def test_share_of_traffic_is_one_where_a_car_stands_and_small_where_one_passes():
    clip = _clip()
    share = traffic_share(clip)
    (u, v), (x, y) = transform_points(
        clip.frame_from_background[0], clip.traffic.poses[[0, 2], [0, 1], :2]
    )
    assert share[int(v), int(u)] == 1.0
    assert 0 < share[int(y), int(x)] <= 0.5


def test_absent_vehicles_leave_no_trace():
    poses = _traffic(6).poses
    poses[:] = np.nan
    clip = _clip(poses=poses)
    assert len(frame_boxes(clip, 0)) == 0
    np.testing.assert_array_equal(render_frame(clip, 3), clean_frame(clip, 3))


def test_shadow_darkens_beside_the_vehicle():
    clip = _clip(shadow=(0.0, 30.0))
    shaded = transform_points(clip.frame_from_background[0], np.array([[250.0, 180.0]]))[0].astype(
        int
    )
    u, v = shaded
    assert render_frame(clip, 0)[v, u].mean() < 0.6 * clean_frame(clip, 0)[v, u].mean()


def test_same_seed_gives_the_same_frames():
    hover = replace(QUIET, noise=2.0, exposure=0.05)
    first, again, other = (list(hover_frames(_clip(hover, seed))) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_traffic_of_another_length_is_refused():
    with pytest.raises(ValueError, match="5 steps for 6 frames"):
        film(
            _still(),
            _traffic(5),
            QUIET,
            height=200,
            width=360,
            generator=np.random.default_rng(0),
        )


def test_drawn_junction_is_the_same_for_the_same_seed(sample):
    again, clip = make_sample(3, hover=SMALL, height=180, width=320, metres_per_pixel=0.2)
    np.testing.assert_array_equal(sample[0].image, again.image)
    np.testing.assert_array_equal(render_frame(sample[1], 7), render_frame(clip, 7))


def test_vehicles_of_the_junction_never_touch(sample):
    traffic = sample[1].traffic
    reach = np.stack([np.cos(traffic.poses[..., 2]), -np.sin(traffic.poses[..., 2])], axis=-1)
    spots = np.linspace(-0.42, 0.42, 5)[:, None, None, None]
    discs = traffic.poses[..., :2] + spots * reach * traffic.sizes[:, :1]  # (5, T, N, 2)
    for step in range(discs.shape[1]):
        now = discs[:, step]
        apart = np.hypot(*np.moveaxis(now[:, :, None, None] - now[None, None], -1, 0))
        for agent in range(now.shape[1]):
            apart[:, agent, :, agent] = np.inf
        assert np.nanmin(apart) > 1.8 / 0.2  # one car's width, in pixels


def test_a_queue_stands_for_over_half_of_the_clip_and_leaves(sample):
    steps = np.hypot(*np.diff(sample[1].traffic.poses[..., :2], axis=0).T)  # (N, T - 1)
    stood = (steps < 0.01).mean(axis=1)
    left = (steps[:, -1] > 1) & (stood > 0.5)
    assert left.sum() >= 3


def test_control_points_reproject_within_a_hundredth_of_a_pixel(sample, tmp_path):
    junction, clip = sample
    write_scene(junction, clip, tmp_path)
    rows = [line.split(",") for line in (tmp_path / "gcps.csv").read_text().splitlines()]
    assert rows[0] == ["name", "u", "v", "lon", "lat"]
    assert len(rows) == 9
    values = np.array([row[1:] for row in rows[1:]], float)
    truth = np.load(tmp_path / "truth.npz")
    world = world_from_lonlat(junction.world, values[:, 2:])
    pixels = transform_points(truth["frame_from_world"][0], world)
    assert np.hypot(*(pixels - values[:, :2]).T).max() < 0.01


def test_written_scene_reads_back(sample, tmp_path):
    junction, clip = sample
    write_scene(junction, clip, tmp_path)
    with av.open(str(tmp_path / "hover.mp4")) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 25
    assert np.abs(frames[12].astype(int) - render_frame(clip, 12)).mean() < 6
    row = (tmp_path / "boxes" / "000012.txt").read_text().splitlines()[0].split()
    assert row[0] == "0"
    left, top, right, bottom = frame_boxes(clip, 12)[0]
    np.testing.assert_allclose(float(row[1]), (left + right) / 2 / 320, atol=1e-5)
    np.testing.assert_allclose(float(row[4]), (bottom - top) / 180, atol=1e-5)


def test_telemetry_tells_where_the_camera_is(sample, tmp_path):
    junction, clip = sample
    write_scene(junction, clip, tmp_path)
    telemetry = read_srt(tmp_path / "hover.SRT")
    truth = np.load(tmp_path / "truth.npz")
    below = transform_points(truth["world_from_frame"], np.array([[160.0, 90.0]]))[:, 0]
    places = lonlat_from_world(junction.world, below)
    np.testing.assert_allclose(telemetry.longitude, places[:, 0], atol=2e-6)
    np.testing.assert_allclose(telemetry.latitude, places[:, 1], atol=2e-6)
    np.testing.assert_allclose(telemetry.time, clip.times, atol=2e-3)
    up = transform_points(truth["world_from_frame"], np.array([[160.0, 89.0]]))[:, 0] - below
    np.testing.assert_allclose(telemetry.yaw, np.arctan2(up[:, 1], up[:, 0]), atol=2e-3)
    side = transform_points(truth["world_from_frame"], np.array([[0.0, 90.0], [320.0, 90.0]]))
    wide = np.hypot(*(side[:, 1] - side[:, 0]).T)
    np.testing.assert_allclose(telemetry.height, wide * 24 / 36, rtol=1e-3)


def test_natural_noise_has_the_slope_asked_for():
    field = natural_noise((256, 256), 1.5, np.random.default_rng(0))
    power = np.abs(np.fft.fft2(field))[1:64, 0] ** 2
    slope = np.polyfit(np.log(np.arange(1, 64)), np.log(power), 1)[0]
    assert slope == pytest.approx(-3.0, abs=0.4)
    assert field.std() == pytest.approx(1.0, abs=1e-3)
