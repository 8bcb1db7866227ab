"""A day: sun, season, and changes on the ground since day 0."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.synthetic.scenery.texture import Colour

Season = Literal["spring", "summer", "autumn", "winter"]
SEASONS: tuple[Season, ...] = get_args(Season)


@dataclass(frozen=True)
class Day:
    """The day on which a place is observed."""

    season: Season = "summer"  # colours of grass and leaves
    azimuth: float = 2.24  # direction to the sun on the plan, radians counter-clockwise from +x
    elevation: float = 1.02  # height of the sun, radians
    clouds: float = 0.0  # 0 for a clear sky, 1 for an overcast one without shadows
    number: int = 0  # seed of what differs between days: parked cars and, with `changes`, more
    changes: int = 0  # number of changes since day 0: trees felled, tar repaired


@dataclass(frozen=True)
class _Palette:
    """Colours of a season."""

    grass: Colour  # mean of lawns
    dry: Colour  # colour of their dry patches
    dryness: float  # extent of the dry patches
    leaves: tuple[Colour, ...]  # colours of trees and shrubs
    light: Colour  # 1 is white


PALETTES: dict[Season, _Palette] = {
    "spring": _Palette(
        (106, 130, 66), (142, 140, 88), -0.9,
        ((132, 158, 76), (116, 146, 70), (146, 160, 84), (170, 150, 150)), (0.99, 1.0, 1.0),
    ),
    "summer": _Palette(
        (104, 118, 70), (150, 142, 92), -0.4,
        ((104, 132, 66), (86, 118, 58), (122, 136, 64), (96, 112, 60)), (1.0, 0.995, 0.98),
    ),
    "autumn": _Palette(
        (112, 114, 70), (146, 134, 92), -0.1,
        ((150, 124, 56), (166, 104, 50), (112, 122, 62), (134, 84, 48)), (1.02, 0.99, 0.94),
    ),
    "winter": _Palette(
        (112, 112, 82), (138, 130, 104), 0.3,
        ((84, 96, 66), (74, 88, 60)), (0.97, 0.99, 1.03),
    ),
}  # fmt: skip


def compute_shadow_offset(day: Day) -> Float[Array, "2"]:
    """Compute where a point one metre high casts its shadow: plan metres from its foot."""
    return -np.array([np.cos(day.azimuth), np.sin(day.azimuth)]) / np.tan(day.elevation)


def compute_shadow_depth(day: Day) -> Float[Array, "3"]:
    """Compute the share of light, 0 to 1, that a shadow takes from red, green and blue."""
    return (1 - day.clouds) * np.array([0.58, 0.55, 0.47])
