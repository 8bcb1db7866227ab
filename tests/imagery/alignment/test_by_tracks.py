from dataclasses import replace

import cv2
import numpy as np
import pytest

from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import transform_points
from geoaim.base.world import World
from geoaim.imagery.alignment.by_tracks import (
    MIN_SIGMA_M,
    align_tracks,
    compute_moments,
    list_shifts,
    sample_poses,
)
from geoaim.imagery.alignment.result import Prior
from geoaim.tracks.tracks import Tracks
from tests.conftest import textured
from tests.imagery.alignment.alignment_pairs import as_aim, made, misplaced

RANGE = Prior(max_shift=10.0, max_rotation=0.06)


def test_picture_is_aligned_under_traffic():
    _, photo, tracks = made()
    stated, matrix = misplaced(photo, shift=(-5.0, 4.0), turn=0.03)
    found = align_tracks(stated, tracks, prior=RANGE)
    apart = transform_points(found.true_from_stated @ matrix, found.center[None])[0] - found.center
    assert np.linalg.norm(apart) < 1.0
    assert apart @ np.linalg.solve(found.covariance, apart) < 9.2
    assert found.model == "rigid"


def test_moments_of_weights_do_not_depend_on_their_sum():
    weight = np.zeros((5, 5))
    weight[1, 3], weight[1, 1] = 3.0, 1.0
    mean, covariance = compute_moments(weight)
    right, left = list_shifts(5)[1, [3, 1]]
    np.testing.assert_allclose(mean, 0.75 * right + 0.25 * left)
    spread = 0.75 * 0.25 * (right - left)[0] ** 2
    np.testing.assert_allclose(covariance, np.diag([spread, 0.0]) + MIN_SIGMA_M**2 * np.eye(2))


def _straight_road():
    """A road along x with three lanes between kerbs and meadows, and who drives on it."""
    generator = np.random.default_rng(1)
    image = textured(generator, 400, 800) // 2 + np.uint8([20, 60, 10])
    asphalt = generator.normal(105, 5, (55, 800, 1)).clip(0, 255).astype(np.uint8)
    image[170:225] = asphalt
    for row in (170, 187, 205, 224):  # 0.2 m a pixel
        cv2.line(image, (0, row), (800, row), (225, 225, 225), 1)
    picture = as_aim(image, np.array([[0.2, 0, -80], [0, -0.2, 40], [0, 0, 1.0]]))
    times = np.arange(0, 10, 0.1)
    states = np.zeros((3, len(times), 4))
    states[..., 0] = -50 + 10 * times
    states[..., 1] = np.array([[4.3], [0.8], [-2.9]])
    states[..., 3] = 10.0
    present = np.ones(states.shape[:2], bool)
    sizes = np.tile([4.5, 1.8], (3, 1))
    return picture, Tracks(times, states, present, sizes, ("car",) * 3, tuple("abc"), World(None))


def test_place_along_a_straight_road_is_undetermined():
    picture, tracks = _straight_road()
    stated, _ = misplaced(picture, shift=(3.0, 4.0))
    found = align_tracks(stated, tracks, prior=RANGE)
    assert found.undetermined_direction is not None
    assert abs(np.sin(found.undetermined_direction)) < 0.05
    assert abs(found.shift[1] + 4.0) < 0.4
    assert abs(found.shift[0]) < 0.1  # it stays where it is stated
    assert found.covariance[0, 0] > 4
    assert found.covariance[1, 1] < 0.3


def test_other_ground_is_refused():
    _, _, tracks = made()
    low = tracks.states[tracks.present][:, :2].min(axis=0)
    image = textured(np.random.default_rng(5), 600, 800)
    matrix = np.array([[0.3, 0, low[0] - 30], [0, -0.3, low[1] + 150], [0, 0, 1.0]])
    with pytest.raises(AlignmentError, match="do not determine the position"):
        align_tracks(as_aim(image, matrix, tracks.world), tracks, prior=RANGE)


@pytest.mark.parametrize("shift", [(14.0, 0.0), (0.0, 16.0)])
def test_shift_beyond_the_prior_is_refused(shift):
    _, photo, tracks = made()
    stated, _ = misplaced(photo, shift=shift)
    with pytest.raises(AlignmentError, match=r"larger prior.max_shift|do not determine"):
        align_tracks(stated, tracks, prior=RANGE)


def test_small_prior_alone_is_no_evidence():
    picture, tracks = _straight_road()
    flat = replace(picture, image=np.full_like(picture.image, 120))
    with pytest.raises(AlignmentError, match="do not determine"):
        align_tracks(flat, tracks, prior=Prior(max_shift=1.5, max_rotation=0.0))


def test_imagery_that_lies_elsewhere_is_refused():
    picture, tracks = _straight_road()
    stated, _ = misplaced(picture, shift=(900.0, 0.0))
    with pytest.raises(AlignmentError, match="shows hardly anything where the tracks are"):
        align_tracks(stated, tracks, prior=RANGE)


def test_pedestrians_and_standing_vehicles_are_ignored():
    picture, tracks = _straight_road()
    walking = replace(tracks, types=("pedestrian",) * 3)
    with pytest.raises(AlignmentError, match="cover 0 cells of 1 m; 100 are needed"):
        align_tracks(picture, walking)
    states = tracks.states * [1, 1, 1, 0]
    assert len(sample_poses(replace(tracks, states=states))) == 0


def test_poses_of_one_cell_count_once():
    _, tracks = _straight_road()
    twice = replace(
        tracks,
        states=np.concatenate([tracks.states] * 2),
        present=np.concatenate([tracks.present] * 2),
        sizes=np.concatenate([tracks.sizes] * 2),
        types=tracks.types * 2,
        ids=tuple("abcdef"),
    )
    assert len(sample_poses(twice)) == len(sample_poses(tracks)) == 300


def test_different_worlds_are_refused():
    picture, tracks = _straight_road()
    with pytest.raises(ValueError, match="the imagery lies in"):
        align_tracks(picture, replace(tracks, world=World("EPSG:32635")))
