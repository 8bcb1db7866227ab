"""Headings and speeds from positions, and a check of a file's own headings."""

import os
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import GeoaimWarning
from geoaim.track_tables import make_tracks
from geoaim.tracks import COLUMNS, Tracks, estimate_heading
from geoaim.world import World

CHECK_HALF_WINDOW_S = 0.25
MIN_CHECKED_SPEED = 1.0  # m/s; the direction of slower motion is too noisy to check a heading
MAX_REVERSED_SHARE = 0.05  # of moving states; fewer against their heading are noise


def derive_motion(tracks: Tracks, *, half_window: float) -> Tracks:
    """Replace headings and speeds by those of the positions over `half_window` seconds either side.

    An agent that stands keeps the direction of its last motion; no agent drives in reverse.
    """
    velocity = estimate_velocity(tracks, half_window)
    states = tracks.states.copy()
    states[..., 2] = np.where(tracks.present, estimate_heading(velocity), np.nan)
    states[..., 3] = np.where(tracks.present, np.hypot(velocity[..., 0], velocity[..., 1]), np.nan)
    return replace(tracks, states=states)


def make_tracks_from_positions(rows: pd.DataFrame, world: World, *, half_window: float) -> Tracks:
    """Make tracks from rows without heading and speed; both are derived from the positions.

    Args:
        rows: has the columns of `make_tracks` other than heading and speed.
        world: the plane of x and y.
        half_window: seconds to each side over which positions are differenced.

    Returns:
        The tracks.
    """
    tracks = make_tracks(rows.assign(heading=0.0, speed=0.0)[list(COLUMNS)], world)
    return derive_motion(tracks, half_window=half_window)


def estimate_velocity(tracks: Tracks, half_window: float) -> Float[Array, "N T 2"]:
    """Estimate velocities by central differences; one-sided where a track begins or ends."""
    velocity = np.full((*tracks.present.shape, 2), np.nan)
    for agent in range(len(tracks.ids)):
        steps = np.flatnonzero(tracks.present[agent])
        positions, times = tracks.states[agent, steps, :2], tracks.times[steps]
        before = np.searchsorted(times, times - half_window)
        after = np.searchsorted(times, times + half_window, side="right") - 1
        dt = np.maximum(times[after] - times[before], 1e-6)  # a lone step has velocity 0
        velocity[agent, steps] = (positions[after] - positions[before]) / dt[:, None]
    return velocity


def fill_headings(rows: pd.DataFrame) -> pd.DataFrame:
    """Fill headings that are NaN: with the agent's last known one, else its next one, else 0."""
    headings = rows.sort_values("time").groupby("id")["heading"]
    return rows.assign(heading=headings.ffill().fillna(headings.bfill()).fillna(0.0))


def compute_signed_speed(
    velocity: Float[Array, "*m 2"], heading: Float[Array, "*m"]
) -> Float[Array, "*m"]:
    """Speeds in m/s, negative where the motion is against the heading.

    >>> compute_signed_speed(np.array([[3.0, 4.0], [0.0, -2.0]]), np.array([0.0, np.pi / 2]))
    array([ 5., -2.])
    """
    along = velocity[..., 0] * np.cos(heading) + velocity[..., 1] * np.sin(heading)
    return np.where(along < 0, -1.0, 1.0) * np.hypot(velocity[..., 0], velocity[..., 1])


def warn_of_reversed_headings(path: str | os.PathLike[str], tracks: Tracks) -> None:
    """Warn when many agents move against the headings that the file gives them."""
    velocity = estimate_velocity(tracks, CHECK_HALF_WINDOW_S)
    speed = compute_signed_speed(velocity, tracks.states[..., 2])
    moving = tracks.present & (np.abs(speed) > MIN_CHECKED_SPEED)
    reversed_ = moving & ((speed < 0) != (tracks.states[..., 3] < 0))
    share = reversed_.sum() / max(moving.sum(), 1)
    if share > MAX_REVERSED_SHARE:
        warnings.warn(
            f"{Path(path)}: {100 * share:.0f} % of the moving states, of "
            f"{reversed_.any(axis=1).sum()} agents, move against their heading. To derive heading "
            "and speed from the positions instead, use "
            "geoaim.track_formats.derive_motion(tracks, half_window=0.5)",
            GeoaimWarning,
            stacklevel=3,
        )
