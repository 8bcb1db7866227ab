"""The scale of a video by the sizes of its cars."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError
from geoaim.base.progress import Progress, no_progress
from geoaim.detection.network import RESOLUTION, find_peaks
from geoaim.detection.vehicles import MIN_PROBABILITY, get_probabilities, resample, to_logit
from geoaim.tracks.agent_types import TYPICAL_SIZES

# metres per pixel that are tried: from 4K at 30 m to coarse satellite pictures; the network finds
# cars that look up to a quarter larger or smaller than they are
TRIED = tuple(float(r) for r in np.geomspace(0.015, 0.6, 12))
MAX_PIXELS = 2.0e6  # of a picture that is searched, of the network's resolution: half a second
CAR = float(np.sqrt(np.prod(TYPICAL_SIZES["car"])))  # metres: square root of its area
SPREAD = 0.25  # of the logarithm of sizes of what counts as a car
FLEET = 0.05  # standard deviation between the mean sizes of cars of towns, as a share
MIN_CARS = 5.0  # expected number in all frames
SEARCHED = 2  # frames that are searched at all scales; all of them at the best one
STEPS = 3  # the first one goes up to a fifth far, the last one 1 %


@dataclass(frozen=True)
class Scale:
    """The scale of a video, and how surely it is known."""

    resolution: float  # metres per pixel
    sigma: float  # standard deviation, as a share of it
    cars: int  # by whose sizes it is told


def propose_scale(
    images: Sequence[UInt8[Array, "H W 3"]], *, progress: Progress = no_progress
) -> Scale:
    """Propose the scale of pictures from above: that at which most cars are found, of usual size.

    Args:
        images: RGB pictures of one size, such as a few frames of a video.
        progress: called with the stage, the scales tried and how many there are.

    Returns:
        Metres per pixel with a standard deviation.

    Raises:
        GeoaimError: too few cars are found at any scale.
    """
    evidence = []
    for number, resolution in enumerate(TRIED):
        progress("propose the scale", number, len(TRIED))
        sizes, probabilities = _measure(images[:: max(len(images) // SEARCHED, 1)], resolution)
        evidence.append(float((_weigh(sizes) * probabilities).sum()))
    resolution = TRIED[int(np.argmax(evidence))]
    for _ in range(STEPS):
        sizes, probabilities = _measure(images, resolution)
        weights = _weigh(sizes) * probabilities
        if weights.sum() < MIN_CARS:
            raise GeoaimError(
                f"the scale is not known, and about {weights.sum():.0f} cars were found at any; "
                f"{MIN_CARS:.0f} are needed to tell it: give the metres per pixel "
                "(--frame-resolution)"
            )
        resolution *= CAR / np.exp(np.average(np.log(sizes), weights=weights))
    deviation = np.sqrt(np.average(np.log(sizes / CAR) ** 2, weights=weights))
    sigma = float(np.hypot(FLEET, deviation / np.sqrt(weights.sum())))
    progress("propose the scale", len(TRIED), len(TRIED))
    return Scale(float(resolution), sigma, round(float(weights.sum())))


def _measure(
    images: Sequence[UInt8[Array, "H W 3"]], resolution: float
) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
    """Measure what is found at a scale: square roots of areas (m), and probabilities."""
    found = [
        find_peaks(resample(_crop(image, resolution), resolution), to_logit(MIN_PROBABILITY))
        for image in images
    ]
    sizes = [np.sqrt(peaks.lengths * peaks.widths) * RESOLUTION for peaks in found]
    return np.concatenate(sizes), np.concatenate([get_probabilities(peaks) for peaks in found])


def _weigh(sizes: Float[Array, " N"]) -> Float[Array, " N"]:
    """Weigh sizes by how likely they are those of cars, 0 to 1."""
    return np.exp(-0.5 * (np.log(sizes / CAR) / SPREAD) ** 2)


def _crop(image: UInt8[Array, "H W 3"], resolution: float) -> UInt8[Array, "h w 3"]:
    """Cut the middle of a picture that would be too large at the network's resolution."""
    height, width = image.shape[:2]
    share = min(1.0, np.sqrt(MAX_PIXELS / (height * width)) * RESOLUTION / resolution)
    high, wide = round(height * share), round(width * share)
    top, left = (height - high) // 2, (width - wide) // 2
    return image[top : top + high, left : left + wide]
