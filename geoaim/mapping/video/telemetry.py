"""Telemetry: the camera's position and attitude over time."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import pairwise

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
# Fields that change the meaning of others, and their ranges.
MODIFIERS = {"roll": (-360.0, 360.0), "zoom": (1.0, 200.0)}
SLOW_MOTION = 1.5  # cameras film at twice the rate of the video or more; dates may be whole seconds
NADIR_DEGREES = 45.0  # from straight down, within which the image's top has a heading


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
    focal_length: Float[Array, " T"]  # millimetres, 35 mm equivalent, with digital zoom
    # why a field is not stated though the file seems to have it, for messages; by field
    remarks: Mapping[str, str] = field(default_factory=dict)
    recorded: float = math.nan  # seconds from the first state to the last by their dates


def make_telemetry(
    times: list[float],
    rows: list[dict[str, float]],
    source: str,
    remarks: Mapping[str, str] | None = None,
) -> Telemetry:
    """Make telemetry from fields as files state them."""
    limits = PLAUSIBLE | MODIFIERS
    table = np.array([[row.get(name, math.nan) for name in limits] for row in rows], np.float64)
    # views of the table's columns
    latitude, longitude, height, altitude, yaw, pitch, focal_length, roll, zoom = table.T
    no_fix = (latitude == 0) & (longitude == 0)  # as DJI writes it
    latitude[no_fix] = longitude[no_fix] = np.nan
    focal_length[focal_length == 0] = np.nan  # EXIF writes 0 for an unknown one
    focal_length *= np.where(np.isnan(zoom), 1.0, zoom)
    if not np.isfinite(latitude + longitude).any():
        raise GeoreferenceError(f"{source}: no latitude and longitude found")
    for (name, (least, greatest)), values in zip(limits.items(), table.T, strict=True):
        wrong = (values < least) | (values > greatest)
        if wrong.any():
            first = int(np.argmax(wrong))
            hint = ": not a place on the Earth; are they swapped?" if name == "latitude" else ""
            raise GeoreferenceError(
                f"{source}: {name} is {values[first]:g} in entry {first + 1}; it lies between "
                f"{least:g} and {greatest:g}{hint}"
            )
    return Telemetry(
        time=np.array(times, np.float64),
        latitude=latitude,
        longitude=longitude,
        height=height,
        altitude=altitude,
        yaw=wrap_angle(np.radians(90.0 - _find_heading_of_top(yaw, pitch, roll))),
        pitch=np.radians(pitch),
        focal_length=focal_length,
        remarks=remarks or {},
    )


def join_telemetry(
    parts: Sequence[Telemetry | None], starts: Float[Array, " P+1"]
) -> Telemetry | None:
    """Join the telemetry of the parts of a video, by the times of their first frames and the end.

    None where no part has any.
    """
    names = [one.name for one in fields(Telemetry) if one.name not in ("remarks", "recorded")]
    whole: dict[str, list[Float[Array, " _"]]] = {name: [] for name in names}
    remarks: dict[str, str] = {}
    for part, (start, end) in zip(parts, pairwise(starts.tolist()), strict=True):
        if part is not None:
            inside = part.time + start < end  # subtitles may outlast the frames of their file
            for name in names:
                values = getattr(part, name)[inside]
                whole[name].append(values + start if name == "time" else values)
            remarks |= part.remarks
    if not whole["time"]:
        return None
    joined = {name: np.concatenate(values) for name, values in whole.items()}
    recorded = sum(math.nan if part is None else part.recorded for part in parts)
    return Telemetry(**joined, remarks=remarks, recorded=recorded)


def _find_heading_of_top(
    yaw: Float[Array, " T"], pitch: Float[Array, " T"], roll: Float[Array, " T"]
) -> Float[Array, " T"]:
    """Find the compass heading of the image's top where the camera looks down; else the yaw.

    Gimbals write straight down also as yaw + 180, pitch -90 and roll 180. A pitch that is not
    stated is taken to be straight down, as it is everywhere. Angles are in degrees.
    """
    down = np.radians(np.where(np.isnan(pitch), -90.0, pitch))
    turn = np.radians(np.where(np.isnan(roll), 0.0, roll))
    by_roll = np.degrees(np.arctan2(np.sin(turn), -np.sin(down) * np.cos(turn)))
    near = np.abs(np.degrees(down) + 90.0) < NADIR_DEGREES
    return np.where(near, yaw + by_roll, yaw)
