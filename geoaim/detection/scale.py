"""The scale of a video: the one at which the network is surest of the vehicles in it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError
from geoaim.base.progress import Progress, no_progress
from geoaim.detection.network import RESOLUTION, Peaks, find_peaks, join_peaks
from geoaim.detection.vehicles import resample
from geoaim.tracks.agent_types import TYPICAL_SIZES

# metres per pixel that are tried, from 4K at 30 m to coarse satellite pictures: the network knows
# vehicles that look a fifth larger or smaller than they are
TRIED = tuple(float(r) for r in np.geomspace(0.015, 0.6, 12))
FRAMES = 4  # spread over a video, by which its scale is proposed
SEARCHED = 2  # frames that are searched at all scales; all of them at the best one
MAX_PIXELS = 2.0e6  # of a picture that is searched, of the network's resolution: half a second
MIN_VEHICLES = 5
# standard deviation of a scale, as a share: between places whose scale is known (cars are a tenth
# larger in Songdo than in Munich, drawn places up to 10 % off), and of one vehicle
PLACES, ONE = 0.08, 0.25
CAR = float(np.sqrt(np.prod(TYPICAL_SIZES["car"])))  # metres: square root of a usual car's area


@dataclass(frozen=True)
class Scale:
    """The scale of a video, and how surely it is known."""

    resolution: float  # metres per pixel
    sigma: float  # standard deviation, as a share of it
    vehicles: int  # by which it is told; 0: it was given


def propose_scale(
    images: Sequence[UInt8[Array, "H W 3"]], *, progress: Progress = no_progress
) -> Scale:
    """Propose the scale of pictures from above: where vehicles are surest, and as large as cars.

    Args:
        images: RGB pictures of one size, such as a few frames of a video.
        progress: called with the stage, the scales tried and how many there are.

    Returns:
        Metres per pixel with a standard deviation.

    Raises:
        GeoaimError: too few vehicles are found at any scale.
    """
    total = len(TRIED) + 1
    few, evidence = images[:: max(len(images) // SEARCHED, 1)], []
    for number, resolution in enumerate(TRIED):
        progress("propose the scale", number, total)
        evidence.append(weigh_scale(few, resolution))
    best = TRIED[int(np.argmax(evidence))]
    progress("propose the scale", len(TRIED), total)
    found = join_peaks([_search(image, best) for image in images])
    progress("propose the scale", total, total)
    count = len(found.logits)
    if count < MIN_VEHICLES:
        raise GeoaimError(
            f"the scale is not known, and {count} vehicles were found at the best one; "
            f"{MIN_VEHICLES} are needed to tell it: give the metres per pixel (--frame-resolution)"
        )
    # the evidence is nearly level around its top: the sizes of vehicles say the rest
    size = float(np.median(np.sqrt(found.lengths * found.widths))) * RESOLUTION
    return Scale(best * CAR / size, float(np.hypot(PLACES, ONE / np.sqrt(count))), count)


def weigh_scale(images: Sequence[UInt8[Array, "H W 3"]], resolution: float) -> float:
    """Weigh the evidence for a scale: the sum of positive log odds a picture, over the scale.

    What is false grows with the picture that is searched, and vehicles do not: divided by the
    scale, the sum peaks within 10 % of the true one (Munich, Songdo, five drawn places).
    """
    return sum(float(_search(image, resolution).logits.sum()) for image in images) / resolution


def _search(image: UInt8[Array, "H W 3"], resolution: float) -> Peaks:
    return find_peaks(resample(_crop(image, resolution), resolution), 0.0)


def _crop(image: UInt8[Array, "H W 3"], resolution: float) -> UInt8[Array, "h w 3"]:
    """Cut the middle of a picture that would be too large at the network's resolution."""
    height, width = image.shape[:2]
    share = min(1.0, np.sqrt(MAX_PIXELS / (height * width)) * RESOLUTION / resolution)
    high, wide = round(height * share), round(width * share)
    top, left = (height - high) // 2, (width - wide) // 2
    return image[top : top + high, left : left + wide]
