"""Telemetry: the camera's position and attitude over time."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import GeoreferenceError
from geoaim.base.geometry import wrap_angle

# Least and greatest possible values, in the units of the files.
PLAUSIBLE = {
    "latitude": (-90.0, 90.0),
    "longitude": (-180.0, 180.0),
    "height": (-1000.0, 6000.0),
    "altitude": (-1000.0, 10000.0),
    "yaw": (-360.0, 360.0),
    "pitch": (-180.0, 180.0),
    "focal_length": (5.0, 1500.0),
}


@dataclass(frozen=True)
class Telemetry:
    """State of the camera over time; NaN where the file does not state it."""

    time: Float[Array, " T"]  # seconds, on the clock of the video's frames
    latitude: Float[Array, " T"]  # degrees, WGS 84
    longitude: Float[Array, " T"]  # degrees, WGS 84
    height: Float[Array, " T"]  # metres above the take-off point
    altitude: Float[Array, " T"]  # metres above sea level, as the drone measures it
    # radians counter-clockwise from east, in [-pi, pi): heading of the camera, and of the top of
    # the image when the camera looks straight down
    yaw: Float[Array, " T"]
    pitch: Float[Array, " T"]  # radians, 0 at the horizon and -pi/2 straight down
    focal_length: Float[Array, " T"]  # millimetres, 35 mm equivalent


def make_telemetry(times: list[float], rows: list[dict[str, float]], source: str) -> Telemetry:
    """Make telemetry from fields as files state them.

    Args:
        times: (T) seconds.
        rows: (T) the fields of `PLAUSIBLE` at each time, of which any may be missing: degrees,
            metres, millimetres; yaw clockwise from north, pitch -90 straight down.
        source: the file that messages name.

    Returns:
        The telemetry in its own units; NaN where a row lacks a field.

    Raises:
        GeoreferenceError: no time has a position, or a value is not possible.
    """
    table = np.array([[row.get(name, math.nan) for name in PLAUSIBLE] for row in rows], np.float64)
    table[(table[:, 0] == 0) & (table[:, 1] == 0), :2] = np.nan  # DJI writes (0, 0) without a fix
    table[table[:, 6] == 0, 6] = np.nan  # EXIF writes 0 for an unknown focal length
    if not np.isfinite(table[:, :2]).all(axis=1).any():
        raise GeoreferenceError(f"{source}: no latitude and longitude found")
    for (name, (least, greatest)), values in zip(PLAUSIBLE.items(), table.T, strict=True):
        wrong = (values < least) | (values > greatest)
        if wrong.any():
            first = int(np.argmax(wrong))
            hint = ": not a place on the Earth; are they swapped?" if name == "latitude" else ""
            raise GeoreferenceError(
                f"{source}: {name} is {values[first]:g} in entry {first + 1}; it lies between "
                f"{least:g} and {greatest:g}{hint}"
            )
    table[:, 4] = wrap_angle(np.radians(90.0 - table[:, 4]))
    table[:, 5] = np.radians(table[:, 5])
    return Telemetry(np.array(times, np.float64), *table.T)
