"""Mosaics under tracks: one shift or one for each part, as the evidence weighs."""

import numpy as np
import pytest

from geoaim.aim.position import CHI2_2D
from geoaim.base.errors import GeoaimWarning
from geoaim.imagery.alignment.by_tracks import align_tracks, compute_moments, list_shifts
from geoaim.imagery.alignment.evidence import TracksEvidence
from geoaim.imagery.alignment.parts import Labels
from geoaim.imagery.alignment.result import Prior
from geoaim.imagery.alignment.tracks_parts import align_parts_to_tracks, weigh_displacement
from tests.imagery.alignment.alignment_pairs import made
from tests.imagery.alignment.test_parts import NAMES, halves

PRIOR = Prior(8.0, 0.0, 0.0)


def _draw_scores(places, sigma):
    """Log-likelihoods of parts whose shifts are known to `sigma` metres."""
    shifts = list_shifts(41)
    return np.stack(
        [-((shifts - place) ** 2).sum(axis=-1) / 2 / sigma**2 for place in np.array(places)]
    )


def test_parts_at_one_place_are_not_displaced():
    scores = _draw_scores([(2.0, 1.0), (2.1, 0.9)], 0.5)
    displaced, weights = weigh_displacement(scores, PRIOR, 0.5)
    assert displaced < 0.1
    for weight in weights:  # both know the place from both
        mean, covariance = compute_moments(weight)
        np.testing.assert_allclose(mean, [2.05, 0.95], atol=0.1)
        assert np.trace(covariance) < 2 * 0.5**2 + 0.1


def test_parts_apart_are_displaced_each_to_its_own_place():
    scores = _draw_scores([(3.0, 0.0), (-3.0, 0.0)], 0.5)
    displaced, weights = weigh_displacement(scores, PRIOR, 0.5)
    assert displaced > 0.999
    np.testing.assert_allclose(compute_moments(weights[0])[0], [3.0, 0.0], atol=0.2)
    np.testing.assert_allclose(compute_moments(weights[1])[0], [-3.0, 0.0], atol=0.2)


def test_parts_that_tell_nothing_leave_the_probability_as_it_was():
    displaced, weights = weigh_displacement(np.zeros((4, 41, 41)), PRIOR, 0.3)
    assert displaced == pytest.approx(0.3)
    np.testing.assert_allclose(weights.sum(axis=(1, 2)), 1.0)


def test_displaced_halves_lie_within_what_is_stated():
    _, photo, labels = halves(((1.5, 0.0), (-1.5, 0.0)))
    _, _, tracks = made()
    whole = align_tracks(photo, tracks, prior=PRIOR)
    places = align_parts_to_tracks(photo, Labels(labels, NAMES), tracks, whole, PRIOR)
    assert places.displaced > 0.05
    for part in places.parts:
        for number, shift in ((1, (-1.5, 0.0)), (2, (1.5, 0.0))):
            if (part.mask & (labels == number)).any():
                off = np.array(shift) - part.alignment.shift
                assert off @ np.linalg.inv(part.alignment.covariance) @ off < CHI2_2D


@pytest.mark.parametrize("files", [True, False])
def test_one_orthophoto_keeps_its_place_and_its_uncertainty(files):
    _, photo, tracks = made()
    labels = Labels(halves()[2], NAMES) if files else None
    whole = align_tracks(photo, tracks, prior=PRIOR)
    places = align_parts_to_tracks(photo, labels, tracks, whole, PRIOR)
    assert places.displaced < 0.25
    [part] = places.parts
    np.testing.assert_allclose(part.alignment.true_from_stated, whole.true_from_stated)


def test_displacement_within_one_file_is_warned_of(monkeypatch):
    _, photo, tracks = made()
    evidence = TracksEvidence(tracks, PRIOR)
    whole = align_tracks(photo, tracks, prior=PRIOR)
    scores = _draw_scores([(3.0, 0.0), (3.0, 0.0), (-3.0, 0.0), (-3.0, 0.0)], 0.5)
    monkeypatch.setattr("geoaim.imagery.alignment.tracks_parts.score_parts", lambda *_: scores)
    with pytest.warns(GeoaimWarning, match="100% parts of the imagery are displaced"):
        [part] = evidence.align_parts(photo, None, whole)
    assert part.alignment.covariance[0, 0] > 3.0**2
