from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import transform_points
from geoaim.base.world import World
from geoaim.imagery.alignment.by_image import align_image, compute_log_false_alarms
from geoaim.imagery.alignment.pipeline import apply_alignment
from geoaim.imagery.alignment.result import Prior
from tests.conftest import textured
from tests.imagery.alignment.alignment_pairs import PHOTO, as_aim, made, misplaced


def _error(found, matrix, aim):
    return np.linalg.norm(
        transform_points(found.true_from_stated @ matrix, aim.corners) - aim.corners, axis=1
    )


@pytest.mark.slow
def test_picture_of_another_day_is_aligned_within_half_a_pixel():
    aim, photo, _ = made()
    stated, matrix = misplaced(photo, shift=(9.0, -7.0), turn=np.radians(4), zoom=1.04)
    found = align_image(stated, aim)
    assert found.model == "similarity"
    assert _error(found, matrix, aim).max() < 0.5 * PHOTO
    assert _error(found, matrix, aim).mean() < 2 * found.uncertainty
    assert found.undetermined_direction is None
    again = apply_alignment(stated, found)
    np.testing.assert_allclose(again.corners, photo.corners, atol=0.5 * PHOTO)


def test_shifted_picture_needs_only_a_translation():
    aim, photo, _ = made()
    stated, _ = misplaced(photo, shift=(-6.0, 3.0))
    found = align_image(stated, aim)
    assert found.model == "translation"
    np.testing.assert_allclose(found.shift, [6.0, -3.0], atol=0.3 * PHOTO)


def test_uncovered_part_of_the_picture_is_ignored():
    aim, photo, _ = made()
    coverage = photo.coverage.copy()
    coverage[:, : coverage.shape[1] // 3] = 0
    holed = replace(
        photo, image=np.where(coverage[..., None] > 0, photo.image, 0), coverage=coverage
    )
    stated, matrix = misplaced(holed, shift=(5.0, 5.0))
    assert _error(align_image(stated, aim), matrix, aim).max() < 0.5 * PHOTO


def _noise(seed, size=(300, 400)):
    matrix = np.array([[0.25, 0, 0], [0, -0.25, 75], [0, 0, 1.0]])
    return as_aim(textured(np.random.default_rng(seed), *size), matrix)


def test_other_ground_is_refused():
    with pytest.raises(AlignmentError, match=r"may be chance\. Is it the same place"):
        align_image(_noise(1), _noise(2))


def test_uniform_ground_is_refused():
    flat = replace(_noise(1), image=np.full((300, 400, 3), 128, np.uint8))
    with pytest.raises(AlignmentError, match="may be chance"):
        align_image(_noise(1), flat)


def test_repetitive_ground_is_refused():
    one = _noise(3, (32, 32))
    ground = replace(one, image=np.tile(one.image, (9, 12, 1)), **_whole((288, 384)))
    stated, _ = misplaced(ground, shift=(1.0, 2.0))
    with pytest.raises(AlignmentError, match="fits in two ways"):
        align_image(stated, ground)


def test_repetitive_ground_is_refused_for_any_prior():
    one = _noise(3, (32, 32))
    ground = replace(one, image=np.tile(one.image, (9, 12, 1)), **_whole((288, 384)))
    stated, _ = misplaced(ground, shift=(1.0, 2.0))
    with pytest.raises(AlignmentError, match="fits in two ways"):
        align_image(stated, ground, prior=Prior(15.0, 0.0, 0.0))


@pytest.mark.parametrize("size", [(214, 380), (160, 160), (128, 640)])
def test_small_and_long_grounds_are_aligned(size):
    """At 0.5 m a pixel: few windows fit on coarse grids."""
    ground = replace(_noise(6, size), world_from_image=np.diag([0.5, -0.5, 1.0]))
    stated, _ = misplaced(ground, shift=(-4.0, 3.0))
    np.testing.assert_allclose(align_image(stated, ground).shift, [4.0, -3.0], atol=0.1)


@pytest.mark.parametrize(
    "given", [{"max_shift": 0.0}, {"max_rotation": 5.0}, {"max_scaling": -0.1}]
)
def test_invalid_prior_is_refused(given):
    with pytest.raises(ValueError, match="are needed"):
        Prior(**given)


def _whole(size):
    return {"coverage": np.ones(size, np.uint16), "contested": np.zeros(size, bool)}


def test_imagery_that_lies_elsewhere_is_refused():
    stated, _ = misplaced(_noise(1), shift=(500.0, 0.0))
    with pytest.raises(AlignmentError, match=r"lies from \(500, .*both must share"):
        align_image(stated, _noise(1))


def test_shift_beyond_the_prior_is_refused():
    stated, _ = misplaced(_noise(1), shift=(14.0, 0.0))
    with pytest.raises(AlignmentError):
        align_image(stated, _noise(1), prior=Prior(max_shift=6.0))


def test_different_worlds_are_refused():
    with pytest.raises(ValueError, match="the imagery lies in"):
        align_image(_noise(1), replace(_noise(1), world=World("EPSG:32635")))


def test_false_alarms_follow_the_binomial_tail():
    share = 3.14159265 * 1.5**2 / 21**2
    assert compute_log_false_alarms(40, 12) == pytest.approx(
        2 + binom.logsf(9, 40, share) / 2.302585093, abs=1e-6
    )
    assert compute_log_false_alarms(40, 2) == 2.0
    assert compute_log_false_alarms(600, 600) == -298.0
