import cv2
import numpy as np
import pytest

from benchmarks.prediction import aim_or_hdmap, pretrained
from benchmarks.prediction.places import (
    DEGRADED_RESOLUTION,
    MAPS,
    TEST,
    TRAIN,
    misplace_map,
    read_map,
)
from geoaim.hdmap.rasterize import SURFACES


def test_training_places_are_not_test_places():
    for kind, train in TRAIN.items():
        assert not {seed for seed, _ in train} & {seed for seed, _ in TEST[kind]}
        assert {place for _, place in TEST[kind]} <= {place for _, place in train}
        assert 1 not in {seed for seed, _ in train}  # the bundled sample's


def test_no_validation_place_is_seen_in_training_or_judged():
    for kind, val in pretrained.VAL.items():
        seeds = {seed for seed, _ in val}
        assert len(seeds) == len(val)
        assert not seeds & {seed for seed, _ in (*TRAIN[kind], *TEST[kind], *aim_or_hdmap.TEST)}
        assert 1 not in seeds  # the bundled sample's
        assert {place for _, place in val} <= {place for _, place in TRAIN[kind]}


@pytest.mark.parametrize("name", MAPS)
def test_every_map_covers_the_place(place, name):
    aim, other = read_map(place, "aim"), read_map(place, name)
    assert other.world.crs == aim.world.crs  # a map from a video has an origin of its own
    middle = aim.corners.mean(axis=0) + np.subtract(aim.world.origin, other.world.origin)
    assert (other.corners.min(axis=0) < middle).all()
    assert (middle < other.corners.max(axis=0)).all()
    if name == "degraded":
        size = round(DEGRADED_RESOLUTION / aim.resolution)
        noise = other.image.astype(float) - cv2.GaussianBlur(aim.image, (0, 0), size)
        assert 30 < noise.std() < 60  # noise of 51, clipped at both ends
        rows, columns = (side // size for side in noise.shape[:2])
        whole = noise[: rows * size, : columns * size]
        squares = whole.reshape(rows, size, columns, size, 3)
        assert squares.mean(axis=(1, 3)).std() > 30  # it does not average out over a metre
    if name == "none":
        assert other.image.std() == 0
    with pytest.raises(ValueError, match="no map 'best'"):
        read_map(place, "best")


def test_complete_hd_maps_show_more(place):
    lanes, full = (read_map(place, name).image for name in ("hdm", "full"))
    for kind in ("walkway", "crosswalk", "parking"):
        shares = [(image == SURFACES[kind]).all(axis=2).mean() for image in (lanes, full)]
        assert 10 * shares[0] < shares[1], kind


def test_misplaced_maps_are_moved_and_resized_about_their_middle(place):
    aim = read_map(place, "aim")
    moved, larger = misplace_map(aim, shift=2.0), misplace_map(aim, scale=1.5)
    step = moved.corners - aim.corners
    assert np.hypot(*step.T) == pytest.approx(2.0)
    assert (step > 0).all()
    assert larger.corners.mean(axis=0) == pytest.approx(aim.corners.mean(axis=0))
    assert np.ptp(larger.corners, axis=0) == pytest.approx(1.5 * np.ptp(aim.corners, axis=0))
