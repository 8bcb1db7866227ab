"""Small clips over a textured ground, with a car that stands for part of the time."""

import cv2
import numpy as np

from geoaim.mapping.video.frames import Frame

SIZE = (120, 200)
CAR = (60, 40, 100, 60)  # left, top, right, bottom


def make_ground():
    """Smooth texture and two painted lines."""
    generator = np.random.default_rng(0)
    noise = generator.normal(0, 60, (*SIZE, 3)).astype(np.float32)
    ground = 110 + cv2.GaussianBlur(noise, (0, 0), 3)
    ground[30:33] = 200
    ground[:, 140:143] = 200
    return ground.clip(0, 255).astype(np.uint8)


def shift(right, down):
    return np.array([[1.0, 0, right], [0, 1.0, down], [0, 0, 1.0]])


def frames_of(images, matrices=None):
    matrices = matrices or [np.eye(3)] * len(images)
    return [
        (Frame(i, float(i), None, image), m)
        for i, (image, m) in enumerate(zip(images, matrices, strict=True))
    ]


def queue(ground, *, count=30, standing=0.6, seed=1):
    """A red car stands for a share of the time, then leaves; others pass on another lane."""
    generator = np.random.default_rng(seed)
    images = []
    for k in range(count):
        image = ground.astype(int)
        left = CAR[0] + (0 if k < standing * count else 25 * (k - int(standing * count)))
        image[CAR[1] : CAR[3], left : left + 40] = (170, 40, 40)
        image[80:100, (37 * k) % 160 : (37 * k) % 160 + 40] = (40, 40, 60)
        images.append((image + generator.normal(0, 2, image.shape)).clip(0, 255).astype(np.uint8))
    return images


def boxes_of_queue(*, count=30, standing=0.6, missing=0.0, scale=1.0, seed=2):
    """Boxes of the two cars of `queue` in each frame; some are left out at random, or resized."""
    generator = np.random.default_rng(seed)
    entries = []
    for k in range(count):
        left = CAR[0] + (0 if k < standing * count else 25 * (k - int(standing * count)))
        other = (37 * k) % 160
        boxes = np.array([[left, CAR[1], left + 40, CAR[3]], [other, 80, other + 40, 100.0]])
        middle, half = (boxes[:, :2] + boxes[:, 2:]) / 2, (boxes[:, 2:] - boxes[:, :2]) / 2
        boxes = np.hstack([middle - scale * half, middle + scale * half])
        is_found = generator.random(2) >= missing
        entries.append(boxes[is_found & (middle[:, 0] < SIZE[1])])  # what has left has no box
    return entries
