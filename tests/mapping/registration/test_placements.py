import numpy as np
import pytest

from geoaim.geometry import translation
from geoaim.mapping.registration.patches import align_patches, make_template, shrink_image
from geoaim.mapping.registration.placements import AmbiguousPlacementError, choose_placement
from geoaim.mapping.registration.rivals import compare_areas, find_rivals, make_overview
from tests.conftest import textured

HEIGHT, WIDTH, FACTOR = 270, 480, 2


def make_grey_texture(generator, height, width):
    return textured(generator, height, width)[..., 0].copy()


def place(reference, frame, start):
    template = make_template(reference)
    found = align_patches(template, frame, start, "homography")
    overview = make_overview(shrink_image(reference, FACTOR), scale=1 / FACTOR)
    return choose_placement(frame, template, overview, found)[0]


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


def test_coherent_traffic_on_most_of_the_image_is_not_taken_for_the_ground():
    reference, frame = film_traffic(shift=40, share=0.6)
    frame = np.roll(frame, 1, axis=1)  # the camera moved by a pixel
    chosen = place(reference, frame, translation(-41.0, 0.0))
    assert np.abs(chosen.matrix - translation(-1.0, 0.0)).max() < 0.05


def test_a_part_that_is_fixed_to_the_frame_is_not_taken_for_the_ground():
    reference, frame = film_traffic(shift=40, share=0.6)
    with pytest.raises(AmbiguousPlacementError, match="two motions"):
        place(reference, frame, translation(-40.0, 0.0))


def test_two_motions_of_similar_speed_are_refused():
    reference, frame = film_traffic(shift=40, share=0.6)
    frame = np.roll(frame, 80, axis=1)  # the camera moved as well
    with pytest.raises(AmbiguousPlacementError, match="two motions"):
        place(reference, frame, translation(-120.0, 0.0))


def test_a_wrong_period_gives_way_to_the_placement_with_more_inliers():
    image = tile(border=80)
    reference, frame = image[:HEIGHT, 48 : 48 + WIDTH], image[:HEIGHT, 50 : 50 + WIDTH]
    chosen = place(reference.copy(), frame.copy(), translation(2.0 + 24.0, 0.0))
    assert abs(chosen.matrix[0, 2] - 2) < 0.1


def test_plain_ground_has_no_rival():
    ground = make_grey_texture(np.random.default_rng(3), HEIGHT, WIDTH + 20)
    reference, frame = ground[:, :WIDTH].copy(), ground[:, 8 : 8 + WIDTH].copy()
    overview = make_overview(shrink_image(reference, FACTOR), scale=1 / FACTOR)
    assert find_rivals(overview, shrink_image(frame, FACTOR), translation(8.0, 0.0)) == []


def test_areas_tell_how_much_of_the_image_each_placement_explains():
    reference, frame = film_traffic(shift=40, share=0.25)
    overview = make_overview(shrink_image(reference, FACTOR), scale=1 / FACTOR)
    small = shrink_image(frame, FACTOR)
    traffic, ground = compare_areas(overview, small, translation(-40.0, 0.0), np.eye(3))
    assert traffic == pytest.approx(0.25, abs=0.06)
    assert ground == pytest.approx(0.75, abs=0.12)


@pytest.mark.parametrize("found", [-20.0, -60.0])
def test_halves_that_move_apart_are_refused_whichever_is_found(found):
    reference, frame = film_traffic(shift=40, share=0.5)
    with pytest.raises(AmbiguousPlacementError, match="two motions"):
        place(reference, np.roll(frame, 20, axis=1), translation(found, 0.0))
