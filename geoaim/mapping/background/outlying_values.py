"""Find values that lie far from their pixel's own ground, whatever they show.

Regions and their borders (`traffic_removal`) miss what is small, thin or faint: a car of a few
pixels, its windows, the rim of a shadow, a vehicle at the edge of the frame whose box is missing.
One such value among thirty leaves a dot of several grey levels in a mean.
"""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from geoaim.mapping.background.stacks import Image, Masks, Stack, compute_median, measure_difference

SIGMAS = 3.0  # standard deviations from the ground beyond which a value is left out
SIGMA_PER_MEDIAN = 1.4826  # of a normal distribution: its deviation over the median difference
SQUARE = np.ones((3, 3), np.uint8)


def mask_outliers(
    stack: Stack, seen: Masks, masks: Masks, background: Image, threshold: float
) -> None:
    """Mask the values that differ from the background by more than their pixel's own spread.

    The spread is the median difference of the frames that are not masked at the pixel, so that at
    least half of them stay: leaves and water keep their mean.

    Args:
        stack: (K, h, w, 3) frames.
        seen: (K, h, w) what they show of the image.
        masks: (K, h, w) traffic in the frames; outliers are added in place.
        background: (h, w, 3) the ground, not a mean of values with outliers.
        threshold: smallest difference of an outlier, grey levels.
    """
    differences = np.stack([measure_difference(frame, background) for frame in stack])
    limit = np.maximum(threshold, measure_spread(differences, seen & ~masks) * SIGMAS)
    for difference, visible, mask in zip(differences, seen, masks, strict=True):
        far = ((difference > limit) & visible).view(np.uint8)
        mask |= cv2.dilate(far, SQUARE).view(bool) & visible


def measure_spread(differences: UInt8[Array, "K h w"], used: Masks) -> Float32[Array, "h w"]:
    """Robust standard deviation at each pixel, of (K, h, w) differences where they are used."""
    median = compute_median(differences.copy()[..., None], used)[..., 0]
    return np.float32(SIGMA_PER_MEDIAN) * median
