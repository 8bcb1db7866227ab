import numpy as np
import pytest

from benchmarks.registration.stability.clips import SweepCase, make_clip
from benchmarks.registration.stability.sweep import run_geoaim
from geoaim.base.geometry import translation
from geoaim.mapping.registration.ambiguity import (
    AmbiguousPlacementError,
    choose_placement,
    compare_placements,
    is_at_rest,
    make_overview,
)
from geoaim.mapping.registration.frame_registration import make_keyframe, register_frame
from geoaim.mapping.registration.patches import align_patches, make_template, shrink_image
from tests.conftest import textured

HEIGHT, WIDTH, FACTOR = 270, 480, 2


def make_grey_texture(generator, height, width):
    return textured(generator, height, width)[..., 0].copy()


def place(reference, frame, start, *, factor=FACTOR, exclude=None):
    template = make_template(reference, exclude=exclude)
    found = align_patches(template, frame, start, "homography")
    overview = make_overview(shrink_image(reference, factor), scale=1 / factor, exclude=exclude)
    rests = is_at_rest(found, template, np.eye(3))
    return choose_placement(reference, frame, template, overview, found, rests=rests)[0]


def film_traffic(shift, share, seed=0):
    """A reference and a frame in which the upper share of the image moves to the right."""
    generator = np.random.default_rng(seed)
    ground = make_grey_texture(generator, HEIGHT, WIDTH)
    traffic = make_grey_texture(generator, HEIGHT, WIDTH + 200)
    rows = round(share * HEIGHT)
    reference, frame = ground.copy(), ground.copy()
    reference[:rows] = traffic[:rows, 100 : 100 + WIDTH]
    frame[:rows] = traffic[:rows, 100 - shift : 100 - shift + WIDTH]
    return reference, frame


def tile(border):
    """Tiles of 24 px, but for a border of other texture."""
    generator = np.random.default_rng(1)
    cell = make_grey_texture(generator, 24, 24)
    image = np.tile(cell, (HEIGHT // 24 + 3, WIDTH // 24 + 6))
    image[:border] = make_grey_texture(generator, border, image.shape[1])
    return image


@pytest.mark.parametrize("found", [-40.0, 0.0])
def test_a_placement_that_a_part_of_the_image_contradicts_is_rejected(found):
    reference, frame = film_traffic(shift=40, share=0.6)
    with pytest.raises(AmbiguousPlacementError, match="moves by itself"):
        place(reference, frame, translation(found, 0.0))


def test_light_traffic_leaves_the_placement_of_the_ground():
    reference, frame = film_traffic(shift=40, share=0.1)
    frame = np.roll(frame, 1, axis=1)  # the camera moved by a pixel
    expected = translation(-1.0, 0.0)
    assert np.abs(place(reference, frame, expected).matrix - expected).max() < 0.05


def test_less_may_move_in_a_frame_that_is_at_rest_as_overlays_are():
    reference, frame = film_traffic(shift=40, share=0.12)
    with pytest.raises(AmbiguousPlacementError, match="moves by itself"):
        place(reference, frame, np.eye(3))


def test_near_motion_counts_in_a_frame_that_is_at_rest():
    reference, frame = film_traffic(shift=4, share=0.2)
    with pytest.raises(AmbiguousPlacementError, match="moves by itself"):
        place(reference, frame, np.eye(3), factor=1)


def test_traffic_on_a_third_leaves_the_placement_of_ground_that_moves_less():
    reference, frame = film_traffic(shift=40, share=0.28)
    expected = translation(-3.0, 0.0)  # the camera moved by three pixels
    found = place(reference, np.roll(frame, 3, axis=1), expected)
    assert np.abs(found.matrix - expected).max() < 0.05


@pytest.mark.parametrize("before", [0.0, -5.0])
def test_a_frozen_part_states_what_moves_beside_it(before):
    """Most of the picture stays as it was, at the reference or later; a tenth moves on."""
    generator = np.random.default_rng(4)
    scene = make_grey_texture(generator, HEIGHT, WIDTH + 20)
    reference, live = scene[:, 10 : 10 + WIDTH], scene[:, 7 : 7 + WIDTH]
    frozen = np.roll(reference, int(before), axis=1)
    frame = np.hstack([frozen[:, :400], live[:, 400:]])
    keyframe = make_keyframe(reference.copy(), None, np.eye(3), 0.0)
    result, _ = register_frame(
        frame, [keyframe], keyframe, translation(-before, 0.0), "translation", compare=False
    )
    assert not result.valid or result.uncertainty > 0.6


def test_more_may_move_by_a_few_pixels_as_roofs_and_trees_do():
    start = translation(-1.0, 0.0)  # the camera moved by a pixel
    near, far = (film_traffic(shift=shift, share=0.3) for shift in (4, 40))
    placed = place(near[0], np.roll(near[1], 1, axis=1), start, factor=1)
    assert np.abs(placed.matrix - start).max() < 1.5
    with pytest.raises(AmbiguousPlacementError, match="moves by itself"):
        place(far[0], np.roll(far[1], 1, axis=1), start, factor=1)


def test_detected_vehicles_do_not_contradict_a_placement():
    reference, frame = film_traffic(shift=40, share=0.3)
    frame, start = np.roll(frame, 1, axis=1), translation(-1.0, 0.0)
    with pytest.raises(AmbiguousPlacementError, match="moves by itself"):
        place(reference, frame, start)
    exclude = np.zeros(reference.shape, bool)
    exclude[: round(0.3 * HEIGHT)] = True
    assert np.abs(place(reference, frame, start, exclude=exclude).matrix - start).max() < 0.05


def test_a_frame_at_rest_is_compared_even_if_others_were_just_now():
    overlaid, later = film_traffic(shift=40, share=0.15)
    keyframe = make_keyframe(overlaid, None, np.eye(3), 0.0)
    result, _ = register_frame(later, [keyframe], keyframe, np.eye(3), "similarity", compare=False)
    assert "moves by itself" in result.reason


def test_vehicles_on_ground_without_texture_do_not_place_a_frame():
    reference, frame = film_traffic(shift=40, share=0.35)
    top = round(0.35 * HEIGHT)
    reference[top:], frame[top:] = 110, 110
    with pytest.raises(AmbiguousPlacementError, match="too little texture"):
        place(reference, frame, translation(-40.0, 0.0))


def test_a_wrong_period_gives_way_to_the_placement_with_more_inliers():
    image = tile(border=110)
    reference, frame = image[:HEIGHT, 48 : 48 + WIDTH], image[:HEIGHT, 50 : 50 + WIDTH]
    chosen = place(reference.copy(), frame.copy(), translation(2.0 + 24.0, 0.0))
    assert abs(chosen.matrix[0, 2] - 2) < 0.1


@pytest.mark.slow
def test_panels_whose_dirt_is_blurred_are_placed_on_no_other_period():
    kind = "solar panels, and defocus"
    case = SweepCase(kind, 5, 1.6, "warped", "junction", (540, 960), 1948458109)
    assert not any(row["error"] > 1 for row in run_geoaim(case, make_clip(case)))


def test_plain_ground_has_no_rival():
    ground = make_grey_texture(np.random.default_rng(3), HEIGHT, WIDTH + 20)
    reference, frame = ground[:, :WIDTH].copy(), ground[:, 8 : 8 + WIDTH].copy()
    overview = make_overview(shrink_image(reference, FACTOR), scale=1 / FACTOR)
    compared = compare_placements(overview, shrink_image(frame, FACTOR), translation(8.0, 0.0))
    assert overview.period is None
    assert compared.textured_share > 0.6
    assert compared.competing_fit_ratio < 0.05
    assert compared.other_peak_strength < 0.2


@pytest.mark.parametrize("noise", [0, 6])
def test_the_share_that_moves_by_itself_is_measured_in_spite_of_noise(noise):
    generator = np.random.default_rng(5)
    reference, frame = (
        np.clip(image + generator.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
        for image in film_traffic(shift=40, share=0.25)
    )
    overview = make_overview(shrink_image(reference, FACTOR), scale=1 / FACTOR)
    compared = compare_placements(overview, shrink_image(frame, FACTOR), np.eye(3))
    assert 0.2 < compared.competing_fit_ratio < 0.25 / 0.75
    assert abs(compared.other_peak[0, 2] + 40) < 2


def test_tiles_repeat():
    image = tile(border=60)[:HEIGHT, :WIDTH].copy()
    period = make_overview(shrink_image(image, FACTOR), scale=1 / FACTOR).period
    assert period is not None
    assert np.abs(period).max() % 24 == 0
