"""Find when a camera hovers, for videos that also show take-off, transit or landing."""

from collections.abc import Iterable

import numpy as np

from geoaim.base.geometry import image_corners, transform_points
from geoaim.mapping.registration.features import detect_features, match_features
from geoaim.mapping.video.frames import Frame

MAX_SPEED = 0.02  # of a corner of the view, in image widths a second; a hovering camera drifts less
MIN_FRAMES = 4  # of a hover


def find_hovers(frames: Iterable[Frame]) -> list[tuple[float, float]]:
    """Find the times in which the view stays from one frame to the next.

    Args:
        frames: spread over the video, in order of time.

    Returns:
        First and last second of each, in order of time; empty where it stays in all frames.
    """
    runs: list[list[float]] = []
    before = None
    for frame in frames:
        size = frame.grey.shape
        features = detect_features(frame.grey)
        stays = False
        if before is not None:
            matrix = match_features(before, features, "homography", size=size)
            limit = MAX_SPEED * size[1] * max(frame.time - runs[-1][-1], 0.5)  # it may sway
            corners = image_corners(*size)
            stays = matrix is not None and bool(
                np.abs(transform_points(matrix, corners) - corners).max() < limit
            )
        if stays:
            runs[-1].append(frame.time)
        else:
            runs.append([frame.time])
        before = features
    if len(runs) == 1:
        return []
    return [(run[0], run[-1]) for run in runs if len(run) >= MIN_FRAMES]
