"""What is read from a mutated file lies within the plausibility that geoaim states."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass

import numpy as np
import torch
from shapely.geometry.base import BaseGeometry

from geoaim.aim.aim import AIM
from geoaim.base.limits import MAX_POSITION_M, MAX_RECORDING_S, MAX_TIME_S
from geoaim.mapping.video.telemetry import PLAUSIBLE, Telemetry
from geoaim.tracks.formats.plausibility import LIMITS, OTHER_LIMITS
from geoaim.tracks.tracks import Tracks

# notes of any kind, and the size of the pixels of a picture of one colour
NOT_MEASURED = ("report", "averaged_over")
LIMITS_BY_NAME = {"video": MAX_RECORDING_S, **dict.fromkeys(("time", "start", ".end"), MAX_TIME_S)}


def describe_implausible(value: object, *, warned: bool) -> str:
    """Describe the first implausible number of what was read; empty where there is none.

    Every fraction is finite or absent (NaN), and no position or time lies beyond the limits that
    tracks and recordings have. Tracks, telemetry, maps and weights have limits of their own.

    Args:
        value: what a reader returned.
        warned: whether it gave a warning, which allows sizes and speeds beyond an agent's type.
    """
    for name, part in _list_numbers("", value):
        limit = next((LIMITS_BY_NAME[key] for key in LIMITS_BY_NAME if key in name), MAX_POSITION_M)
        if (np.isinf(part).any() and not name.endswith(".finest")) or (
            np.abs(part[np.isfinite(part)]) > limit
        ).any():
            return f"{name} reaches {np.nanmax(np.abs(part)):g}"
    return "; ".join(_describe_parts(value, warned))


def _list_numbers(name: str, value: object) -> Iterator[tuple[str, np.ndarray]]:
    """All fractions in nested data, with their names."""
    if isinstance(value, torch.Tensor):
        value = value.detach().numpy()
    if isinstance(value, BaseGeometry):
        value = np.array(value.bounds)
    if isinstance(value, np.ndarray | float) and np.asarray(value).dtype.kind == "f":
        yield name, np.asarray(value)
    elif is_dataclass(value):
        for field in fields(value):
            if field.name in NOT_MEASURED:
                continue
            yield from _list_numbers(f"{name}.{field.name}", getattr(value, field.name))
    elif isinstance(value, Mapping | list | tuple):
        items = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, part in items:
            yield from _list_numbers(f"{name}.{key}", part)


def _describe_parts(value: object, warned: bool) -> Iterator[str]:
    if isinstance(value, Tracks) and not warned:
        yield from _describe_tracks(value)
    elif isinstance(value, Telemetry):
        yield from _describe_telemetry(value)
    elif isinstance(value, AIM):
        if not np.abs(value.corners).max() <= MAX_POSITION_M:
            yield f"a corner at {np.abs(value.corners).max():g} m"
    elif isinstance(value, torch.nn.Module):
        weights = value.state_dict().items()
        yield from (f"{name} is not finite" for name, part in weights if not part.isfinite().all())


def _describe_tracks(tracks: Tracks) -> Iterator[str]:
    for index, kind in enumerate(tracks.types):
        limits = LIMITS.get(kind, OTHER_LIMITS)
        speed = np.nanmax(np.abs(tracks.states[index, :, 3]))
        found = (*tracks.sizes[index], speed)
        if (np.array(found) > limits).any():
            yield f"a {kind} of {found[0]:g} x {found[1]:g} m and {speed:g} m/s"


def _describe_telemetry(telemetry: Telemetry) -> Iterator[str]:
    for name, (least, greatest) in PLAUSIBLE.items():
        values = getattr(telemetry, name)
        if name in ("yaw", "pitch"):
            least, greatest = -np.pi, np.pi
        if ((values < least) | (values > greatest)).any():
            yield f"{name} from {np.nanmin(values):g} to {np.nanmax(values):g}"
