import cv2
import numpy as np
import pytest

from geoaim.base.errors import BackgroundError
from geoaim.mapping.background.running_mean import average_frames
from geoaim.mapping.background.traffic_search import remove_traffic
from geoaim.mapping.video.video import open_video
from tests.mapping.background.clips import CAR, SIZE, frames_of, queue, shift


def crop_car(image):
    return image[CAR[1] : CAR[3], CAR[0] : CAR[2]].astype(float)


def test_mean_of_shifted_frames_is_the_ground(ground):
    matrices = [shift(dx, dy) for dx, dy in [(0, 0), (3, -2), (-5, 4), (2, 2)]]
    images = [cv2.warpAffine(ground, m[:2], SIZE[::-1], flags=cv2.INTER_NEAREST) for m in matrices]
    result = average_frames(frames_of(images, [np.linalg.inv(m) for m in matrices]), size=SIZE)
    inside = np.s_[10:-10, 10:-10]
    assert np.abs(result.image[inside].astype(int) - ground[inside]).max() <= 1
    assert result.frames_used == 4
    assert (result.coverage[inside] == 4).all()


def test_pixels_that_no_frame_reaches_are_black_uncovered_and_not_contested(ground):
    result = average_frames(frames_of([ground], [shift(50, 0)]), size=SIZE)
    assert not result.image[:, :50].any()
    assert not result.coverage[:, :50].any()
    assert not result.contested.any()


def test_the_image_can_reach_beyond_the_reference(ground):
    frames = frames_of([ground, ground], [shift(10, 20), shift(50, 20)])
    result = average_frames(frames, size=(140, 260))
    np.testing.assert_allclose(
        result.image[30:130, 12:48].astype(int), ground[10:110, 2:38], atol=1
    )
    assert result.coverage[70, 230] == 1
    assert result.coverage[70, 100] == 2


def test_gain_brings_frames_to_the_exposure_of_the_first(ground):
    darker = np.rint(ground * 0.8).astype(np.uint8)
    result = average_frames(frames_of([ground, darker, darker]), size=SIZE)
    np.testing.assert_allclose(result.gains, [1, 1.25, 1.25], rtol=0.01)
    assert np.abs(result.image.astype(int) - ground)[5:-5, 5:-5].mean() < 1


def test_gain_ignores_a_bus_over_most_of_the_view(ground):
    bus = ground.copy()
    bus[:, 60:] = np.random.default_rng(3).integers(0, 255, bus[:, 60:].shape)
    result = average_frames(frames_of([ground, bus]), size=SIZE)
    np.testing.assert_allclose(result.gains[1], 1, atol=0.02)


def test_detections_leave_the_car_out(ground):
    images = queue(ground)
    plain = average_frames(frames_of(images), size=SIZE)
    boxed = average_frames(
        frames_of(images),
        size=SIZE,
        detections=lambda f: (
            np.array([CAR, (0, 78, 200, 102)], float) if f.index < 25 else np.zeros((0, 4))
        ),
    )
    truth = crop_car(ground)
    assert np.abs(crop_car(plain.image) - truth).mean() > 20
    assert np.abs(crop_car(boxed.image) - truth).mean() < 2
    assert not boxed.contested.any()


def test_always_masked_pixels_show_the_mean_and_are_contested_and_uncovered(ground):
    result = average_frames(
        frames_of([ground] * 3), size=SIZE, detections=lambda _: np.array([CAR], float)
    )
    inside = np.s_[CAR[1] : CAR[3], CAR[0] : CAR[2]]
    assert result.contested[inside].all()
    assert not result.coverage[inside].any()
    np.testing.assert_allclose(result.image.astype(int), ground, atol=1)
    assert result.contested.mean() < 0.05


def test_frames_without_known_detections_are_left_out(ground):
    known = {1: np.zeros((0, 4))}
    result = average_frames(
        frames_of([ground // 2, ground, ground // 2]),
        size=SIZE,
        detections=lambda f: known.get(f.index),
    )
    assert result.frames_used == 1


def test_each_pixel_of_a_mean_in_three_bands_averages_every_third_frame(ground):
    result = average_frames(frames_of([ground] * 6), size=SIZE, bands=3)
    assert (result.coverage[5:-5, 5:-5] == 2).all()
    np.testing.assert_allclose(result.image[5:-5, 5:-5].astype(int), ground[5:-5, 5:-5], atol=1)


def test_sharpness_of_a_subpixel_mean_is_kept(ground):
    generator = np.random.default_rng(5)
    large = cv2.resize(ground, None, fx=8, fy=8, interpolation=cv2.INTER_CUBIC)
    large = cv2.GaussianBlur(large, (0, 0), 5)
    images, matrices = [], []
    for dx, dy in generator.integers(-16, 17, (12, 2)):
        moved = cv2.warpAffine(large, np.float64([[1, 0, dx], [0, 1, dy]]), large.shape[1::-1])
        images.append(cv2.resize(moved, SIZE[::-1], interpolation=cv2.INTER_AREA))
        matrices.append(shift(-dx / 8, -dy / 8))
    truth = cv2.resize(large, SIZE[::-1], interpolation=cv2.INTER_AREA).astype(float)
    image = average_frames(frames_of(images, matrices), size=SIZE).image.astype(float)
    one, two = (np.diff(picture[10:-10, 10:-10], axis=1) for picture in (image, truth))
    assert ((one * two).sum() / (two**2).sum()) ** 2 > 0.97


def test_planes_of_a_video_give_the_same_mean_as_rgb(ground, tmp_path):
    from geoaim.base.encode import write_video

    path = write_video([ground] * 8, tmp_path / "a.mp4", crf=5)
    frames = list(open_video(path))
    assert frames[0].planes is not None
    planes = average_frames([(f, np.eye(3)) for f in frames], size=SIZE)
    rgb = average_frames(frames_of([f.image for f in frames]), size=SIZE)
    apart = np.abs(planes.image.astype(int) - rgb.image)[5:-5, 5:-5]
    assert apart.mean() < 2


def test_always_masked_pixels_of_a_video_keep_their_colour(ground, tmp_path):
    from geoaim.base.encode import write_video

    path = write_video([ground] * 4, tmp_path / "a.mp4", crf=5)
    frames = [(f, np.eye(3)) for f in open_video(path)]
    boxed = average_frames(frames, size=SIZE, detections=lambda _: np.array([CAR], float))
    plain = average_frames(frames, size=SIZE)
    assert np.abs(boxed.image.astype(int) - plain.image).max() <= 2


@pytest.mark.parametrize("standing", [0.6, 0.75])
def test_a_car_that_stands_for_most_of_the_time_is_removed(ground, standing):
    images = queue(ground, standing=standing)
    median = np.median(images, axis=0)
    result = remove_traffic(frames_of(images), size=SIZE)
    truth = crop_car(ground)
    assert np.abs(crop_car(median) - truth).mean() > 50
    assert np.abs(crop_car(result.image) - truth).mean() < 3
    assert result.contested.mean() < 0.02


def test_a_car_that_arrives_and_stays_is_removed(ground):
    result = remove_traffic(frames_of(queue(ground)[::-1]), size=SIZE)
    assert np.abs(crop_car(result.image) - crop_car(ground)).mean() < 3


def test_a_mark_on_the_ground_is_kept_where_a_car_stands_for_less_than_half_the_time(ground):
    marked = ground.copy()
    marked[CAR[1] + 4 : CAR[3] - 4, CAR[0] + 4 : CAR[2] - 4] = 220
    result = remove_traffic(frames_of(queue(marked, standing=0.4)), size=SIZE)
    assert np.abs(crop_car(result.image) - crop_car(marked)).mean() < 3


def test_ground_that_no_frame_shows_is_contested(ground):
    generator = np.random.default_rng(2)
    images = [ground.copy() for _ in range(20)]
    for image in images:
        image[40:60, 60:100] = generator.integers(0, 255, 3)
    result = remove_traffic(frames_of(images), size=SIZE)
    assert result.contested[44:56, 64:96].all()
    assert result.contested.mean() < 0.15


@pytest.mark.parametrize("count", [0, 3])
def test_too_few_frames_are_refused(ground, count):
    with pytest.raises(BackgroundError, match="at least 4"):
        remove_traffic(frames_of([ground] * count), size=SIZE)


def test_a_mean_of_nothing_is_refused():
    with pytest.raises(BackgroundError, match="no frame to average"):
        average_frames([], size=SIZE)


def test_one_shot_iterator_is_refused(ground):
    with pytest.raises(TypeError, match="read twice"):
        remove_traffic(iter(frames_of([ground] * 5)), size=SIZE)
