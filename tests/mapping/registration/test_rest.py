"""A camera that is said to stand still, over traffic that covers most of its view."""

import numpy as np

from geoaim.mapping.registration.register import register
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
