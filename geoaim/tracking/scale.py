"""The scale of a video by the vehicles in it, and whether a map's scale can be right."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy import ndimage

from geoaim.aim.aim import AIM
from geoaim.base.errors import warn
from geoaim.tracks.agent_types import TYPICAL_SIZES, select_group
from geoaim.tracks.tracks import Tracks

WINDOW = 0.12  # standard deviation of the logarithms of sizes of cars
MIN_FACTOR = 2.0  # by which vehicles are smaller or larger than cars where the scale is doubted
CAR_M = float(np.sqrt(np.prod(TYPICAL_SIZES["car"])))  # square root of its area
MIN_AGENTS = 3  # whose sizes tell a wrong scale, and that are askew
# length over width of what can be a vehicle: an articulated bus has 7.2
MAX_SLENDER = 8.0
# share of vehicles that move that lie across their paths or askew: 0 to 0.03 of eight videos of
# vehicles without boxes, three of them real, and of 33 cases with hard boxes; 0.79 to 1 of four of
# people who had been taken for cars, 0.18 to 0.33 of four of turned boxes read as upright ones
MAX_ASKEW = 0.1
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


def find_askew(tracks: Tracks) -> str:
    """Find whether many vehicles that move can be none: they lie across their paths, or askew.

    Vehicles move along their longer side. Sizes are fitted to boxes by the direction of motion, so
    that what moves across is wider than long, and what moves askew has no width. So do people who
    are taken for cars, as which they look at some scale, where they walk as fast as cars drive
    (1.3 m/s becomes 7 m/s), and boxes that are turned and were taken for upright ones. Says how
    many; "" where all but a few can be vehicles.
    """
    places, stop = tracks.get_rows("states")[:, :2], np.cumsum(tracks.present.sum(axis=1))
    way = places[stop - 1] - places[np.concatenate([[0], stop[:-1]])]
    moved = np.hypot(*way.T) > tracks.sizes.max(axis=1)
    moved &= select_group(tracks.types, "vehicle")
    slender = tracks.sizes[moved, 0] / tracks.sizes[moved, 1]
    odd, count = int(((slender < 1) | (slender > MAX_SLENDER)).sum()), int(moved.sum())
    if odd < MIN_AGENTS or odd <= MAX_ASKEW * count:
        return ""
    return f"{odd} of {count} vehicles that move lie across their paths or askew, as none does"
