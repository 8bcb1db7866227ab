"""Mosaics on the made place: each part is placed for itself, where it needs it."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from geoaim.aim.position import CHI2_2D, read_position_covariance, state_position
from geoaim.base.errors import AlignmentError, GeoaimWarning
from geoaim.base.geometry import translation
from geoaim.imagery.alignment.before_after import draw_alignment
from geoaim.imagery.alignment.evidence import (
    AimEvidence,
    TracksEvidence,
    align_mosaic,
    place_mosaic,
)
from geoaim.imagery.alignment.parts import Labels, align_parts, crop_to_mask, mask_imagery
from geoaim.imagery.alignment.result import ImageryAlignment, Prior
from geoaim.imagery.mosaic import Mosaic
from tests.imagery.alignment.alignment_pairs import as_aim, made, misplaced

PRIOR = Prior(8.0, 0.02, 0.01)
NAMES = ("west.tif", "east.tif")
SHIFTS = np.array([[3.0, 0.0], [-3.0, 0.0]])


@cache
def halves(shifts=((3.0, 0.0), (-3.0, 0.0))):
    """The picture with halves that are displaced, and the number of each pixel's half."""
    aim, photo, _ = made()
    height, width = photo.coverage.shape
    labels = np.ones((height, width), np.uint16)
    labels[:, width // 2 :] = 2
    image = photo.image.copy()
    for number, shift in enumerate(shifts, 1):
        matrix = photo.grid.grid_from_world @ translation(*shift) @ photo.world_from_image
        moved = cv2.warpAffine(photo.image, matrix[:2], (width, height), flags=cv2.INTER_CUBIC)
        image[labels == number] = moved[labels == number]
    return aim, replace(photo, image=image), labels


def test_halves_of_two_files_are_placed_each_for_itself():
    aim, photo, labels = halves()
    with pytest.warns(GeoaimWarning, match=r"displaced each for itself: (west|east)\.tif"):
        found = place_mosaic(Mosaic(photo, labels, NAMES), AimEvidence(aim, PRIOR))
    parts = {part["name"]: part for part in found.report["alignment"]["aim"]["parts"]}
    for name, shift in zip(NAMES, SHIFTS, strict=True):
        np.testing.assert_allclose(parts[name]["shift_m"], -shift, atol=0.3)
    lines = found.summarize()
    assert lines["alignment by aim"] == "each part for itself"
    assert "m east" in lines["part west.tif"]
    figure = draw_alignment(found, aim=aim)
    assert figure.axes[2].get_title("left").endswith("2 parts")


def test_tracks_place_files_as_one_and_say_so():
    _, photo, labels = halves(((0.5, 0.0), (-0.5, 0.0)))
    evidence = TracksEvidence(made()[2], Prior(8.0, 0.0, 0.0))
    with pytest.warns(GeoaimWarning, match="the 2 files of the imagery as one.*--aim"):
        [part] = align_mosaic(Mosaic(photo, labels, NAMES), evidence)
    assert part.mask.all()


@pytest.mark.slow
def test_halves_within_one_file_are_found():
    aim, photo, labels = halves()
    with pytest.warns(GeoaimWarning, match="displaced each for itself"):
        found = place_mosaic(Mosaic(photo, None, ("one.tif",)), AimEvidence(aim, PRIOR))
    parts = found.report["alignment"]["aim"]["parts"]
    shifts = sorted(part["shift_m"][0] for part in parts)
    np.testing.assert_allclose(shifts, [-3.0, 3.0], atol=0.3)
    truth = made()[1]
    covered = (found.coverage > 0) & (truth.coverage > 0)
    covered &= np.abs(np.arange(labels.shape[1]) - labels.shape[1] / 2) > 40
    off = np.abs(found.image[covered].astype(int) - truth.image[covered]).mean()
    stated = np.abs(photo.image[covered].astype(int) - truth.image[covered]).mean()
    assert off < stated / 2


def test_files_that_agree_get_one_place():
    aim, photo, _ = made()
    moved, matrix = misplaced(photo, shift=(2.0, -1.0))
    labels = halves()[2]
    parts = align_mosaic(Mosaic(moved, labels, NAMES), AimEvidence(aim, PRIOR))
    assert [part.name for part in parts] == ["all"]
    np.testing.assert_allclose(parts[0].alignment.shift, -matrix[:2, 2], atol=0.15)


def _drawn(shifts, sigma=0.05):
    """An aligner of drawn shifts: by the value of the imagery that it is given."""

    def align(imagery):
        [number] = np.unique(imagery.image[imagery.coverage > 0])
        if not np.isfinite(shifts[number]).all():
            raise AlignmentError("nothing to see")
        covariance = np.eye(2) * sigma**2
        return ImageryAlignment(
            translation(*shifts[number]), "translation", covariance, np.zeros(2)
        )

    return align


def _striped(count):
    numbers = np.repeat(np.arange(count), 10)[None].repeat(20, axis=0)
    image = np.repeat(numbers[..., None], 3, axis=2).astype(np.uint8)
    labels = Labels((numbers + 1).astype(np.uint16), [f"{n}.tif" for n in range(count)])
    return as_aim(image, np.diag([1.0, -1.0, 1.0])), labels


def test_part_without_evidence_is_placed_as_the_others_and_as_unsure_as_they_differ():
    imagery, labels = _striped(3)
    shifts = np.array([[4.0, 0.0], [-2.0, 0.0], [np.nan, np.nan]])
    found = align_parts(imagery, labels, _drawn(shifts), None, PRIOR.max_shift)
    parts = {part.name: part for part in found}
    rest = parts["2.tif"]
    assert not rest.placed
    np.testing.assert_allclose(rest.alignment.shift, [1.0, 0.0])
    for shift in shifts[:2]:
        off = shift - rest.alignment.shift
        assert off @ np.linalg.inv(rest.alignment.covariance) @ off < CHI2_2D


def test_parts_that_agree_leave_another_as_unsure_as_the_prior():
    """Two parts a centimetre apart do not tell that a third one is as near."""
    imagery, labels = _striped(3)
    shifts = np.array([[4.0, 0.0], [4.01, 0.0], [np.nan, np.nan]])
    found = align_parts(imagery, labels, _drawn(shifts), None, 8.0)
    [rest] = [part for part in found if not part.placed]
    np.testing.assert_allclose(rest.alignment.covariance, np.eye(2) * 12.0, rtol=0.01)


def test_region_that_nothing_confirms_stays_with_the_part_beside_it():
    imagery, labels = _striped(3)
    shifts = np.array([[4.0, 0.0], [-2.0, 0.0], [np.nan, np.nan]])
    places = [_drawn(shifts)(mask_imagery(imagery, labels.numbers == k)) for k in (1, 2)]
    labels = labels._replace(found=places, beside={3: 2})
    found = align_parts(imagery, labels, _drawn(shifts), None, 8.0)
    [rest] = [part for part in found if not part.placed]
    np.testing.assert_allclose(rest.alignment.shift, [-2.0, 0.0])
    off = np.array([6.0, 0.0])
    assert off @ np.linalg.inv(rest.alignment.covariance) @ off < CHI2_2D


def test_part_that_was_found_stays_where_it_was_found():
    """Windows that found a part may be too few to find it again by its own pixels."""
    imagery, labels = _striped(2)
    shifts = np.array([[4.0, 0.0], [np.nan, np.nan]])
    places = [
        _drawn(np.array([[4.0, 0.0], [1.0, 2.0]]))(mask_imagery(imagery, labels.numbers == k))
        for k in (1, 2)
    ]
    found = align_parts(imagery, labels._replace(found=places), _drawn(shifts), None, 8.0)
    assert all(part.placed for part in found)
    np.testing.assert_allclose(sorted(part.alignment.shift[0] for part in found), [1.0, 4.0])


def test_parts_that_differ_by_chance_get_one_place():
    imagery, labels = _striped(3)
    shifts = np.array([[0.05, 0.0], [-0.04, 0.02], [0.0, 0.06]])
    whole = ImageryAlignment(np.eye(3), "translation", np.eye(2) * 0.001, np.zeros(2))
    assert align_parts(imagery, labels, _drawn(shifts), whole, 8.0) == []
    assert align_parts(imagery, labels, _drawn(shifts * 100), whole, 8.0)
    alone = np.where(np.arange(3)[:, None] > 0, np.nan, shifts)
    assert align_parts(imagery, labels, _drawn(alone), whole, 8.0) == []


def test_mask_keeps_pixels():
    imagery, labels = _striped(2)
    masked = mask_imagery(imagery, labels.numbers == 2)
    np.testing.assert_array_equal(masked.coverage > 0, labels.numbers == 2)


def test_crop_shows_the_same_ground():
    imagery, labels = _striped(3)
    cropped = crop_to_mask(imagery, labels.numbers == 2)
    assert cropped.image.shape == (20, 10, 3)
    assert (cropped.image == 1).all()
    np.testing.assert_allclose(cropped.corners[:, 0], [10, 20, 20, 10])


def _state(aim, covariance, off=(0.0, 0.0)):
    moved = replace(aim, world_from_image=translation(*off) @ aim.world_from_image)
    return replace(moved, report={"position": state_position("a test", np.array(covariance))})


@pytest.mark.slow
def test_chain_of_three_passes_the_uncertainty_on():
    """A map that is 5 m off along its road, within what it states, and two pictures after it."""
    aim, photo, _ = made()
    reference = _state(aim, [[0.01, 0.0], [0.0, 9.0]], off=(0.0, 5.0))
    first = photo
    stated = []
    for _ in range(2):
        found = place_mosaic(Mosaic(first, None, ("a",)), AimEvidence(reference, PRIOR))
        error = found.corners.mean(axis=0) - photo.corners.mean(axis=0)
        covariance = read_position_covariance(found.report)
        assert error @ np.linalg.inv(covariance) @ error < CHI2_2D
        stated.append(np.sqrt(np.diag(covariance)))
        position = found.report["position"]
        assert np.trace(position["relative_covariance_m2"]) < 0.1
        lines = found.summarize()
        assert "m at azimuth" in lines["in the world (95 %)"]
        reference = found
    assert all(east < 0.3 and 1 < north < 4 for east, north in stated)


def test_good_picture_stays_along_the_road_of_an_unsure_map():
    aim, photo, _ = made()
    reference = _state(aim, [[0.01, 0.0], [0.0, 64.0]], off=(0.0, 5.0))
    sure = replace(photo, report={"position": state_position("a test", np.eye(2) * 0.04)})
    found = place_mosaic(Mosaic(sure, None, ("a",)), AimEvidence(reference, PRIOR))
    np.testing.assert_allclose(found.corners, photo.corners, atol=0.15)
    offset = found.report["position"]["offset_from_reference_m"]
    np.testing.assert_allclose(offset, [0.0, 5.0], atol=0.2)
    assert "m away at azimuth" in found.summarize()["relative to the aim (95 %)"]


def test_map_without_a_statement_is_taken_as_right_and_named():
    aim, photo, _ = made()
    found = place_mosaic(Mosaic(photo, None, ("a",)), AimEvidence(aim, PRIOR))
    assert found.report["position"]["assumes"] == ["aim"]
    assert found.summarize()["in the world (95 %)"].endswith("taking the aim as right")
