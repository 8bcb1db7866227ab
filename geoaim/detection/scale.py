"""The scale of a video: the one at which the network is surest of the vehicles in it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError
from geoaim.base.progress import Progress, no_progress
from geoaim.detection.network import RESOLUTION, find_peaks
from geoaim.detection.vehicles import resample

# metres per pixel that are tried, from 4K at 30 m to coarse satellite pictures: the network knows
# vehicles that look a fifth larger or smaller than they are
TRIED = tuple(float(r) for r in np.geomspace(0.015, 0.6, 12))
FINE = tuple(float(f) for f in 1.15 ** np.arange(-2.0, 2.5))  # around the best of these
FRAMES = 4  # spread over a video, by which its scale is proposed
SEARCHED = 2  # frames that are searched at all scales; all of them around the best one
MAX_PIXELS = 2.0e6  # of a picture that is searched, of the network's resolution: half a second
MIN_VEHICLES = 5.0
# standard deviation of a scale, as a share: between places whose scale is known (4 to 8 % off on
# the stills of Munich and Songdo that trained), and of one vehicle
PLACES, ONE = 0.08, 0.25


@dataclass(frozen=True)
class Scale:
    """The scale of a video, and how surely it is known."""

    resolution: float  # metres per pixel
    sigma: float  # standard deviation, as a share of it
    vehicles: int  # by which it is told; 0: it was given


def propose_scale(
    images: Sequence[UInt8[Array, "H W 3"]], *, progress: Progress = no_progress
) -> Scale:
    """Propose the scale of pictures from above: that at which vehicles look most like vehicles.

    Args:
        images: RGB pictures of one size, such as a few frames of a video.
        progress: called with the stage, the scales tried and how many there are.

    Returns:
        Metres per pixel with a standard deviation.

    Raises:
        GeoaimError: too few vehicles are found at any scale.
    """
    total = len(TRIED) + len(FINE)
    few, evidence = images[:: max(len(images) // SEARCHED, 1)], []
    for number, resolution in enumerate(TRIED):
        progress("propose the scale", number, total)
        evidence.append(weigh_scale(few, resolution)[0])
    middle = int(np.argmax(evidence))
    best = TRIED[middle]
    found = []
    for number, factor in enumerate(FINE, len(TRIED)):
        progress("propose the scale", number, total)
        found.append(weigh_scale(images, best * factor))
    progress("propose the scale", total, total)
    values, counts = np.array(found).T
    top = int(np.argmax(values))
    if counts[top] < MIN_VEHICLES:
        raise GeoaimError(
            f"the scale is not known, and {counts[top]:.0f} vehicles were found at the best one; "
            f"{MIN_VEHICLES:.0f} are needed to tell it: give the metres per pixel "
            "(--frame-resolution)"
        )
    near = slice(max(middle - 1, 0), middle + 2)
    scales = np.concatenate([best * np.array(FINE), TRIED[near]])
    resolution = find_top(scales, np.concatenate([values, evidence[near]]))
    return Scale(resolution, float(np.hypot(PLACES, ONE / np.sqrt(counts[top]))), int(counts[top]))


def find_top(scales: Float[Array, " n"], values: Float[Array, " n"]) -> float:
    """Find the scale at which values are highest, by a parabola through the logarithms of all.

    Around the best scale the evidence is nearly level, so that the highest value alone is up to
    17 % off.

    >>> round(find_top(np.array([0.8, 1.0, 1.25]), np.array([1.0, 2.0, 1.0])), 2)
    1.0
    """
    x, share = np.log(scales), np.maximum(values / values.max(), 1e-9)
    curve, slope, _ = np.polyfit(x, np.log(share), 2, w=share**2)
    top = -slope / (2 * curve) if curve < 0 else x[int(np.argmax(values))]
    return float(np.exp(np.clip(top, x.min(), x.max())))


def weigh_scale(images: Sequence[UInt8[Array, "H W 3"]], resolution: float) -> tuple[float, int]:
    """Weigh the evidence for a scale: the sum of positive log odds a picture, and their number.

    What is false grows with the picture that is searched, and vehicles do not: divided by the
    scale, the sum peaks within 8 % of the true one (Munich, Songdo, three drawn places).
    """
    parts = [
        find_peaks(resample(_crop(image, resolution), resolution), 0.0).logits for image in images
    ]
    logits = np.concatenate(parts)
    return float(logits.sum() / resolution / len(images)), len(logits)


def _crop(image: UInt8[Array, "H W 3"], resolution: float) -> UInt8[Array, "h w 3"]:
    """Cut the middle of a picture that would be too large at the network's resolution."""
    height, width = image.shape[:2]
    share = min(1.0, np.sqrt(MAX_PIXELS / (height * width)) * RESOLUTION / resolution)
    high, wide = round(height * share), round(width * share)
    top, left = (height - high) // 2, (width - wide) // 2
    return image[top : top + high, left : left + wide]
