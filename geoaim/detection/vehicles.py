"""Vehicles in one picture: oriented boxes with probabilities."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError
from geoaim.detection.network import RESOLUTION, Peaks, find_peaks, read_calibration
from geoaim.mapping.video.detections import DetectedBoxes

MIN_PROBABILITY = 0.5  # a box is more probably right than wrong


def detect_vehicles(
    image: Array, resolution: float, *, min_probability: float = MIN_PROBABILITY
) -> DetectedBoxes:
    """Detect vehicles in a picture from above.

    Args:
        image: RGB of 8 bits, of shape (height, width, 3).
        resolution: metres per pixel, right to 20 %; `propose_scale` finds it.
        min_probability: boxes below are left out.

    Returns:
        Oriented boxes in pixels, the first side of whose corners points forward, as far as the
        picture tells; with the probability that each is right.

    Raises:
        GeoaimError: the picture is not RGB of 8 bits.

    Example:
        >>> import numpy as np
        >>> len(detect_vehicles(np.full((240, 320, 3), 90, np.uint8), 0.2).boxes)
        0
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise GeoaimError(
            f"a picture of shape {image.shape} and type {image.dtype} was found; "
            "RGB of 8 bits, of shape (height, width, 3), is needed"
        )
    if not resolution > 0:
        raise ValueError(f"resolution is {resolution}; metres per pixel, over 0, are needed")
    peaks = find_peaks(resample(image, resolution), to_logit(min_probability))
    height, width = image.shape[:2]
    factor = _get_factor((height, width), resolution)
    corners = peaks.get_corners() / factor
    bounds = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
    return DetectedBoxes(bounds, corners, get_probabilities(peaks))


def resample(image: UInt8[Array, "H W 3"], resolution: float) -> UInt8[Array, "h w 3"]:
    """Resample a picture of a resolution to that of the network."""
    wide, high = np.round(_get_factor(image.shape[:2], resolution) * image.shape[1::-1]).astype(int)
    is_smaller = resolution < RESOLUTION
    how = cv2.INTER_AREA if is_smaller else cv2.INTER_LINEAR
    return cv2.resize(image, (int(wide), int(high)), interpolation=how)


def _get_factor(size: tuple[int, ...], resolution: float) -> Float[Array, "2"]:
    """Get by how much width and height are scaled, to whole pixels."""
    shape = np.array([size[1], size[0]], float)
    return np.maximum(np.round(shape * resolution / RESOLUTION), 1) / shape


def get_probabilities(peaks: Peaks) -> Float[Array, " N"]:
    """Get the probability that each vehicle is one, as calibrated."""
    slope, offset = read_calibration()
    return 1 / (1 + np.exp(-(slope * peaks.logits + offset)))


def to_logit(probability: float) -> float:
    """Get the network's log odds that a probability stands for."""
    if not 0 < probability < 1:
        raise ValueError(f"a probability between 0 and 1 is needed, not {probability}")
    slope, offset = read_calibration()
    return float((np.log(probability / (1 - probability)) - offset) / slope)
