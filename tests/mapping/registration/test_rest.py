"""A camera that stands still, over traffic that covers most of its view."""

import numpy as np

from geoaim.mapping.registration.register import choose_reference, register
from geoaim.mapping.registration.rest import may_stand, stands_still
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import open_video
from tests.conftest import textured

SIZE = (240, 320)
COUNT = 8
STILL_ROWS = 80  # of the ground that no traffic covers


def film(*, moved=()):
    """Frames of one ground, two thirds of which a texture passes; some are moved as a whole."""
    ground = textured(np.random.default_rng(1), SIZE[0], SIZE[1] + 40)
    traffic = textured(np.random.default_rng(2), SIZE[0], SIZE[1] + 20 * COUNT)
    frames = []
    for k in range(COUNT):
        left = 4 if k in moved else 0
        image = ground[:, left : left + SIZE[1]].copy()
        image[STILL_ROWS:] = traffic[STILL_ROWS:, 20 * k : 20 * k + SIZE[1]]
        noise = np.random.default_rng(k).normal(0, 2, image.shape)
        frames.append((image + noise).clip(0, 255).astype(np.uint8))
    return frames


def test_traffic_on_two_thirds_of_the_view_does_not_matter():
    registration = register(film(), model="rest")
    assert registration.valid.all()
    assert (registration.reference_from_frame == np.eye(3)).all()
    assert registration.uncertainty.max() < 0.1
    assert registration.reference.model == "rest"


def test_a_frame_that_has_moved_is_rejected():
    registration = register(film(moved=(3, 5)), model="rest")
    assert np.flatnonzero(~registration.valid).tolist() == [3, 5]
    assert "not at rest" in registration.reason[3]


def test_a_frame_of_something_else_is_rejected():
    frames = film()
    frames[4] = textured(np.random.default_rng(7), *SIZE)
    assert np.flatnonzero(~register(frames, model="rest").valid).tolist() == [4]


def film_road(*, is_overlay=False, count=12):
    """Frames of the lower three quarters that textures cover in turn; or those lie over a drift."""
    image = textured(np.random.default_rng(1), SIZE[0], SIZE[1] + 4 * count)
    traffic = textured(np.random.default_rng(2), SIZE[0], SIZE[1] + 20 * count)
    frames = []
    for k in range(count):
        if is_overlay:
            shown = traffic[:, : SIZE[1]].copy()
            shown[:60] = image[:60, 4 * k : 4 * k + SIZE[1]]
        else:
            shown = image[:, : SIZE[1]].copy()
            top = 60 + 60 * (k % 3)
            shown[top : top + 60] = traffic[top : top + 60, 20 * k : 20 * k + SIZE[1]]
        noise = np.random.default_rng(k).normal(0, 2, shown.shape)
        frames.append((shown + noise).clip(0, 255).astype(np.uint8))
    return frames


def list_frames(images):
    return [Frame(k, float(k), None, image) for k, image in enumerate(images)]


def test_a_camera_that_stands_is_found_by_ground_that_traffic_covers_at_times():
    registration = register(film_road())
    assert registration.reference.model == "rest"
    assert registration.valid.all()


def test_an_overlay_is_never_covered_and_is_no_ground():
    overlay = film_road(is_overlay=True)
    assert not stands_still(list_frames(overlay))
    assert choose_reference(open_video(overlay), time=0.0).model != "rest"


def test_ground_that_has_moved_by_a_pixel_does_not_rest():
    ground = textured(np.random.default_rng(1), SIZE[0], SIZE[1] + 8)
    first, *others = list_frames([ground[:, k : k + SIZE[1]].copy() for k in range(5)])
    keyframe = choose_reference(open_video([first.image]), model="translation", time=0.0).keyframe
    assert may_stand([first] * 3, keyframe)
    assert not may_stand(others[:1] * 3, keyframe)
    assert not may_stand([first, *others], keyframe)


def test_few_frames_do_not_tell_that_a_camera_stands():
    road = list_frames(film_road())
    assert stands_still(road)
    assert not stands_still(road[:7])


def test_a_given_model_is_kept():
    assert register(film_road(), model="translation").reference.model == "translation"


def test_frozen_blocks_that_compression_renews_in_turn_are_no_ground():
    image = textured(np.random.default_rng(1), SIZE[0], SIZE[1] + 60)
    frozen, frames = image[:, : SIZE[1]].copy(), []
    for k in range(12):
        rows = slice(160, 240) if k in (1, 2) else slice(20 * (k - 1), 20 * k)
        frozen[rows] = image[rows, 5 * k : 5 * k + SIZE[1]]
        frames.append(frozen.copy())
    assert not stands_still(list_frames(frames))
