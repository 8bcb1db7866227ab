"""Headings and speeds from the motion, and whether a file's own agree with it."""

import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import GeoaimWarning
from geoaim.tracks import COLUMNS, Tracks, estimate_heading, make_tracks
from geoaim.world import World

if TYPE_CHECKING:
    from pandas import DataFrame

LEAST = 0.3  # m/s under which a motion has no direction
MOVING = 1.0  # m/s from which a motion tells the heading
BACKWARDS = 0.05  # the share of moving states against their heading that is not noise


def with_motion(tracks: Tracks, *, reach: float) -> Tracks:
    """The same places, with the speed and heading of the way within `reach` seconds to each side.

    Who stands keeps the direction; nobody is seen to drive in reverse.
    """
    velocity = velocity_of(tracks, reach)
    states = tracks.states.copy()
    states[..., 2] = np.where(tracks.present, estimate_heading(velocity), np.nan)
    states[..., 3] = np.where(tracks.present, np.hypot(velocity[..., 0], velocity[..., 1]), np.nan)
    return replace(tracks, states=states)


def tracks_of_places(rows: "DataFrame", world: World, *, reach: float) -> Tracks:
    """Tracks from rows without heading and speed."""
    tracks = make_tracks(rows.assign(heading=0.0, speed=0.0)[list(COLUMNS)], world)
    return with_motion(tracks, reach=reach)


def velocity_of(tracks: Tracks, reach: float) -> Float[Array, "N T 2"]:
    """Central differences; at the ends and beside gaps one-sided ones; 0 for a lone step."""
    velocity = np.full((*tracks.present.shape, 2), np.nan)
    for agent in range(len(tracks.ids)):
        steps = np.flatnonzero(tracks.present[agent])
        places, times = tracks.states[agent, steps, :2], tracks.times[steps]
        before = np.searchsorted(times, times - reach)
        after = np.searchsorted(times, times + reach, side="right") - 1
        apart = np.maximum(times[after] - times[before], 1e-6)
        velocity[agent, steps] = (places[after] - places[before]) / apart[:, None]
    return velocity


def kept_heading(rows: "DataFrame") -> "DataFrame":
    """The rows with unknown headings filled: who stands keeps the direction it had, or will have.

    Args:
        rows: with id, time and heading, which is NaN where unknown.
    """
    along = rows.sort_values("time").groupby("id")["heading"]
    return rows.assign(heading=along.ffill().fillna(along.bfill()).fillna(0.0))


def signed_speed(velocity: Float[Array, "m 2"], heading: Float[Array, "m"]) -> Float[Array, "m"]:
    """The speed in m/s, negative when it goes against the heading.

    >>> signed_speed(np.array([[3.0, 4.0], [0.0, -2.0]]), np.array([0.0, np.pi / 2]))
    array([ 5., -2.])
    """
    along = velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading)
    return np.where(along < 0, -1.0, 1.0) * np.hypot(velocity[:, 0], velocity[:, 1])


def warn_of_backwards(path: str | os.PathLike[str], tracks: Tracks) -> None:
    """Warn when many agents move against the heading that the file gives them."""
    velocity = velocity_of(tracks, 0.25)
    heading, forwards = tracks.states[..., 2], np.where(tracks.states[..., 3] < 0, -1.0, 1.0)
    along = velocity[..., 0] * np.cos(heading) + velocity[..., 1] * np.sin(heading)
    moving = tracks.present & (np.hypot(velocity[..., 0], velocity[..., 1]) > MOVING)
    against = moving & (along * forwards < 0)
    share = against.sum() / max(moving.sum(), 1)
    if share > BACKWARDS:
        warnings.warn(
            f"{Path(path)}: {100 * share:.0f} % of the moving states, of "
            f"{against.any(axis=1).sum()} agents, go against their heading. To take heading and "
            "speed from the way instead: geoaim.track_formats.with_motion(tracks, reach=0.5)",
            GeoaimWarning,
            stacklevel=3,
        )
