"""Boxes against the picture: a slip of boxes is named by what they would lie on."""

import re
import warnings
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from geoaim.mapping.box_evidence import View, check_evidence, compare
from geoaim.mapping.georeference.from_telemetry import make_local_georeference
from geoaim.mapping.pipeline import build_aim
from geoaim.mapping.video.detections import DetectedBoxes, read_detections
from geoaim.mapping.video.video import open_video

SAMPLES = Path(__file__).parents[2] / "samples"

HEIGHT, WIDTH, FRAMES, RATE = 180, 320, 240, 25.0
AGENTS = 9


def find_ends(step):
    """Left, top, right, bottom of agents that drive to the right and one that stands."""
    row = np.arange(AGENTS)
    x = 20 + (0.7 + 0.2 * row) * step * (row < AGENTS - 1) + 11 * row
    y = 12 + 12.0 * row
    return np.column_stack([x - 9, y - 4, x + 9, y + 4])[x < WIDTH - 12]


def drift(step):
    """The transform from a frame to the reference."""
    return np.array([[1, 0, 0.2 * step], [0, 1, -0.1 * step], [0, 0, 1.0]])


@pytest.fixture(scope="module")
def views():
    found = []
    for step in range(5, FRAMES, 20):
        differs = np.zeros((HEIGHT, WIDTH))
        for left, top, right, bottom in find_ends(step)[:-1].round().astype(int):
            differs[top:bottom, left:right] = 1
        found.append(View(step, differs, np.ones((HEIGHT, WIDTH), bool)))
    return found


def check(views, read):
    boxes = {step: DetectedBoxes(own) for step in range(FRAMES) if (own := read(step)) is not None}
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        matrices = {step: drift(step) for step in range(FRAMES)}
        few = check_evidence(views, boxes, matrices, (WIDTH, HEIGHT), RATE)
    assert few in (None, 0)
    return "too few" if few == 0 else " ".join(str(one.message) for one in said)


def pad(own):
    return own * [1, 0.5625, 1, 0.5625] + np.array([0, 0.21875 * HEIGHT] * 2)


def turn_over(own):
    return np.c_[own[:, 0], HEIGHT - own[:, 3], own[:, 2], HEIGHT - own[:, 1]]


def stabilise(step):
    return find_ends(step) + np.tile(drift(step)[:2, 2], 2)


@pytest.mark.parametrize(
    ("read", "expected"),
    [
        (find_ends, ""),
        (lambda step: find_ends(step) if step % 5 == 0 else None, ""),
        (lambda step: find_ends(step)[:, [1, 0, 3, 2]], "x and y exchanged"),
        (lambda step: turn_over(find_ends(step)), "y counts from the bottom"),
        (lambda step: pad(find_ends(step)), "a square to which frames were padded"),
        (stabilise, "stabilised"),
        (lambda step: find_ends(step - 4) if step > 3 else None, "surely .* [345] frames earlier"),
        (lambda step: find_ends(step + 3) if step < 237 else None, "surely .* [123] frames later"),
        (lambda step: find_ends(step - 12) if step >= 12 else None, "1[123] frames earlier"),
        (lambda step: find_ends(step + 60) if step < FRAMES - 60 else None, "(59|6.) frames later"),
        (lambda step: find_ends(3 * step) if step < FRAMES / 3 else None, "--rate 8.333"),
        (lambda step: find_ends(step * 7 % 97) * [1, 0.3, 1, 0.3] + [0, 120, 0, 120],
         "are they of this video"),
        (lambda step: np.empty((0, 4)), "too few"),
    ],
)  # fmt: skip
def test_a_slip_of_boxes_is_named_and_right_ones_are_left_alone(views, read, expected):
    said = check(views, read)
    assert re.search(expected, said)
    assert bool(said) == bool(expected)


def test_what_stands_all_the_time_tells_nothing(views):
    standing = find_ends(0) + np.array([0, 60, 0, 60])
    said = check(views, lambda step: standing - np.tile(drift(step)[:2, 2], 2))
    assert said == "too few"


def test_a_map_of_other_brightness_and_contrast_is_compared():
    ground = np.random.default_rng(0).integers(60, 120, (HEIGHT, WIDTH)).astype(np.uint8)
    frame = np.asarray(1.3 * ground + 20, np.uint8)
    frame[50:60, 100:120] = 250
    differs = compare(frame, ground, np.ones(frame.shape, bool))
    assert differs[52:58, 103:117].min() == 1
    assert differs[:40].mean() < 0.2


@pytest.mark.parametrize(("late", "expected"), [(0, ""), (5, "[3456] frames earlier")])
def test_build_says_that_boxes_are_late(late, expected):
    whole = open_video(SAMPLES / "hover.mp4")
    read = read_detections(SAMPLES / "boxes", classes=["car"] * 9, video=whole)
    first = list(islice(whole, 0, 60))
    frames = [cv2.resize(f.image, None, fx=0.5, fy=0.5) for f in first]
    boxes = [read(frame).boxes / 2 for frame in first]
    boxes = boxes[:1] * late + boxes[: len(boxes) - late]
    scale = make_local_georeference(resolution=0.26, size=frames[0].shape[:2])
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        build_aim(open_video(frames, rate=25.0), scale, detections=boxes)
    found = " ".join(str(one.message) for one in said)
    assert re.search(expected, found)
    assert bool(found) == bool(expected)
