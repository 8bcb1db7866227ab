"""Noise of detections, estimated from how they scatter about smooth tracks."""

import numpy as np
from jaxtyping import Int
from numpy import ndarray as Array

from geoaim.tracking.ground_detections import GroundDetections

DEFAULT_NOISE_PX = 2.0  # of a coordinate of a box's middle, where too few detections tell
MIN_NOISE_PX = 0.3
MIN_TRIPLES = 30  # detections in three successive frames that tell the noise
NORMAL_SCALE = 1.4826  # standard deviation of a normal distribution over its median distance


def estimate_noise(detections: GroundDetections, track: Int[Array, "M"]) -> float:
    """Estimate the standard deviation of a coordinate of boxes' middles, in pixels of the frame.

    From one frame to the next but one a track is nearly straight, so that its second differences
    are noise alone, of six times the variance of a position.

    Args:
        detections: detections in order of time.
        track: number of each detection's agent; -1 for none.

    Returns:
        Pixels.
    """
    order = np.lexsort((detections.step, track))
    order = order[(track[order] >= 0) & ~detections.cut[order].any(axis=(1, 2))]
    step, agent = detections.step[order], track[order]
    pixels = detections.position[order] / detections.resolution[order, None]
    triple = (agent[2:] == agent[:-2]) & (step[2:] - step[:-2] == 2)
    second = (pixels[2:] - 2 * pixels[1:-1] + pixels[:-2])[triple]
    if len(second) < MIN_TRIPLES:
        return DEFAULT_NOISE_PX
    spread = NORMAL_SCALE * float(np.median(np.abs(second))) / np.sqrt(6)
    return max(spread, MIN_NOISE_PX)
