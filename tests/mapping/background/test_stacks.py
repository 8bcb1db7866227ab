import numpy as np

from geoaim.mapping.background.stacks import (
    average_at,
    compute_median,
    estimate_noise,
    find_alike,
    find_pixels,
)

WHITE = np.full((3, 4, 3), 250, np.uint8)


def test_median_and_noise_are_those_of_the_frames_that_see_a_pixel():
    generator = np.random.default_rng(0)
    stack = np.rint(generator.normal(100, 5, (22, 40, 40, 3))).astype(np.uint8)
    seen = np.ones((22, 40, 40), bool)
    seen[::2, :, 20:] = False
    median = compute_median(stack.copy(), seen)
    np.testing.assert_allclose(median[:, 20:], np.median(stack[1::2, :, 20:], axis=0), atol=1)
    assert 4 < estimate_noise(stack, seen, median) < 12


def test_frames_that_look_alike_are_averaged_and_others_left_out():
    stack = np.stack([WHITE - 4, WHITE, WHITE // 2])
    pixels = find_pixels(np.eye(3, 4, dtype=np.uint8))
    assert pixels.tolist() == [[0, 1, 2], [0, 1, 2]]
    colours = WHITE[tuple(pixels)]
    alike = find_alike(stack, pixels, colours, 8)
    assert alike.tolist() == [[True] * 3, [True] * 3, [False] * 3]
    assert (average_at(stack, pixels, alike, colours) == 248).all()


def test_the_default_stays_where_no_frame_is_selected():
    pixels, default = np.array([[0], [0]]), np.array([[1, 2, 3]], np.uint8)
    none = np.zeros((1, 1), bool)
    assert (average_at(WHITE[None], pixels, none, default) == default).all()
