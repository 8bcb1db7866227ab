"""Noise of detections, estimated from how they scatter about smooth tracks."""

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.mapping.box_evidence import MIN_BOXES
from geoaim.tracking.ground_detections import GroundDetections

DEFAULT_NOISE_PX = 2.0  # of a coordinate of a box's middle, where too few detections tell
SLOW_DT = 0.2  # s; time between frames in which agents accelerate by more than the noise
# by which boxes scatter more in jumps than usually, extents more than middles, and errors that last
# more than sizes, which are estimated from the same boxes, leave of them
MARGIN = 1.2
NORMAL_SCALE = 1.4826  # standard deviation of a normal distribution over its median distance


def estimate_noise(
    detections: GroundDetections, track: Int[Array, "M"], times: Float[Array, "T"]
) -> float:
    """Estimate the standard deviation of a coordinate of boxes' middles, in pixels of the frame.

    From one frame to the next but one a track (-1: none) is nearly straight, so that its second
    differences are noise alone, of six times the variance of a position. Where frames are seldom,
    agents are not straight in between, and the default is given.
    """
    if len(times) < 2 or times[1] - times[0] > SLOW_DT:
        return DEFAULT_NOISE_PX
    order = np.lexsort((detections.step, track))
    order = order[(track[order] >= 0) & ~detections.may_be_cut[order]]
    step, agent = detections.step[order], track[order]
    pixels = detections.position[order] / detections.resolution[order, None]
    triple = (agent[2:] == agent[:-2]) & (step[2:] - step[:-2] == 2)
    second = (pixels[2:] - 2 * pixels[1:-1] + pixels[:-2])[triple]
    if len(second) < MIN_BOXES:
        return DEFAULT_NOISE_PX
    spread = NORMAL_SCALE * float(np.median(np.abs(second))) / np.sqrt(6)
    return max(spread, 0.3)


def estimate_lasting_noise(
    residual: Float[Array, "m 2"], resolution: Float[Array, "m"], noise: float
) -> float:
    """Estimate the part of the noise of a coordinate of boxes' middles that lasts, in pixels.

    Errors of opposite sides are taken for independent, so that half the difference of a box's
    extent from what it should be (m) scatters as its middle does. What goes beyond the noise
    between successive frames (pixels), lasts.
    """
    if len(residual) < MIN_BOXES:
        return 0.0
    pixels = residual / resolution[:, None]
    spread = NORMAL_SCALE * float(np.median(np.abs(pixels - np.median(pixels, axis=0)))) / 2
    lasting = np.sqrt(max(spread**2 - (MARGIN * noise) ** 2, 0.0))
    return float(MARGIN * lasting)
