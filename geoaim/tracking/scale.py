"""The scale of a video by the vehicles in it, and whether a map's scale can be right."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy import ndimage

from geoaim.aim.aim import AIM
from geoaim.base.errors import warn
from geoaim.tracking.box_checks import MIN_AGENTS, find_askew
from geoaim.tracks.agent_types import TYPICAL_SIZES
from geoaim.tracks.tracks import Tracks

WINDOW = 0.12  # standard deviation of the logarithms of sizes of cars
MIN_FACTOR = 2.0  # by which vehicles are smaller or larger than cars where the scale is doubted
CAR_M = float(np.sqrt(np.prod(TYPICAL_SIZES["car"])))  # square root of its area
PEOPLE = "people look like cars at another scale (--frame-resolution)"


def _find_most(sides: Float[Array, " n"]) -> float:
    """The side about which most lie, as shares of it; a small piece counts less than a vehicle."""
    logs = np.log(sides)
    steps = np.arange(logs.min() - WINDOW, logs.max() + WINDOW, WINDOW / 20)
    counts, _ = np.histogram(logs, steps, weights=sides)
    smooth = ndimage.gaussian_filter1d(counts, 20)
    return float(np.exp(steps[smooth.argmax()] + WINDOW / 40))


def check_scale(tracks: Tracks, aim: AIM) -> float | None:
    """Check a scale by `measure_scale_error`, and warn where it cannot be right."""
    if text := find_askew(tracks):
        warn(f"{text}: {PEOPLE}")
    factor = measure_scale_error(tracks, aim)
    if factor is not None:
        length, width = np.array(TYPICAL_SIZES["car"]) / factor
        warn(
            f"most of what moves is about {length:.2g} x {width:.2g} m; if these are cars, the "
            f"map's scale is wrong, and a pixel has {factor:.2g} times as many metres "
            "(--frame-resolution)"
        )
    return factor


def measure_scale_error(tracks: Tracks, aim: AIM) -> float | None:
    """Measure how much too small (above 1) or large an assumed scale is; None: it may be right.

    Control points or imagery tell a scale, telemetry or a user assumes it. The types of the tracks
    follow from their sizes.
    """
    georeference = aim.report.get("georeference", {})
    if not georeference.get("approximate", False):
        return None
    if len(tracks.ids) < MIN_AGENTS:
        return None
    factor = CAR_M / _find_most(np.sqrt(tracks.sizes.prod(axis=1)))
    return None if 1 / MIN_FACTOR < factor < MIN_FACTOR else factor
