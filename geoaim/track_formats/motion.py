"""Speeds and headings of tracks, computed from positions where a file states none."""

from dataclasses import replace

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.track_tables import make_tracks
from geoaim.tracks import COLUMNS, Tracks, estimate_heading
from geoaim.world import World


def derive_motion(tracks: Tracks, *, half_window: float) -> Tracks:
    """Replace headings and speeds by those of the positions over `half_window` seconds either side.

    The velocities are those of `estimate_velocity`, 0 where it gives none. An agent that stands
    keeps the direction of its last motion; no agent drives in reverse.
    """
    velocity = np.nan_to_num(estimate_velocity(tracks, half_window))
    states = tracks.states.copy()
    states[..., 2] = np.where(tracks.present, estimate_heading(velocity), np.nan)
    states[..., 3] = np.where(tracks.present, np.hypot(velocity[..., 0], velocity[..., 1]), np.nan)
    return replace(tracks, states=states)


def derive_speeds(tracks: Tracks, *, half_window: float) -> Tracks:
    """Replace speeds by those of the positions over `half_window` seconds either side.

    As `derive_motion`, but headings stay: an agent that moves against its own drives in reverse,
    and has a negative speed.
    """
    velocity = np.nan_to_num(estimate_velocity(tracks, half_window))
    states = tracks.states.copy()
    speed = compute_signed_speed(velocity, states[..., 2])
    states[..., 3] = np.where(tracks.present, speed, np.nan)
    return replace(tracks, states=states)


def make_tracks_from_positions(rows: pd.DataFrame, world: World, *, half_window: float) -> Tracks:
    """Make tracks from rows without heading and speed; `derive_motion` computes both.

    Args:
        rows: one for each agent and time; columns id, type, time (s), x, y, length, width (m).
        world: the plane of x and y.
        half_window: seconds to each side over which positions are differenced.

    Returns:
        The tracks.

    Raises:
        TracksError: `make_tracks` refuses the rows.
    """
    tracks = make_tracks(rows.assign(heading=0.0, speed=0.0)[list(COLUMNS)], world)
    return derive_motion(tracks, half_window=half_window)


def estimate_velocity(tracks: Tracks, half_window: float) -> Float[Array, "N T 2"]:
    """Estimate velocities (m/s) by differences of positions over `half_window` seconds either side.

    A window that is shorter than the median time between an agent's states is widened to it.
    Differences are one-sided where a track begins or ends; NaN where the window holds no other
    state.
    """
    present_agent, present_step = np.nonzero(tracks.present)
    gaps = np.diff(tracks.times[present_step])[np.diff(present_agent) == 0]
    half_window = max(half_window, 1.01 * float(np.median(gaps)) if len(gaps) else 0.0)
    velocity = np.full((*tracks.present.shape, 2), np.nan)
    for agent in range(len(tracks.ids)):
        steps = np.flatnonzero(tracks.present[agent])
        positions, times = tracks.states[agent, steps, :2], tracks.times[steps]
        before = np.searchsorted(times, times - half_window)
        after = np.searchsorted(times, times + half_window, side="right") - 1
        dt = times[after] - times[before]
        dt[dt == 0] = np.nan
        velocity[agent, steps] = (positions[after] - positions[before]) / dt[:, None]
    return velocity


def fill_headings(rows: pd.DataFrame) -> pd.DataFrame:
    """Fill NaN in the column heading: with the agent's last known one, else its next, else 0.

    The rows also need the columns id and time. The result is a copy.
    """
    headings = rows.sort_values("time").groupby("id")["heading"]
    return rows.assign(heading=headings.ffill().fillna(headings.bfill()).fillna(0.0))


def compute_signed_speed(
    velocity: Float[Array, "*m 2"], heading: Float[Array, "*m"]
) -> Float[Array, "*m"]:
    """Compute speeds from velocities (m/s), negative where these point against the heading (rad).

    >>> compute_signed_speed(np.array([[3.0, 4.0], [0.0, -2.0]]), np.array([0.0, np.pi / 2]))
    array([ 5., -2.])
    """
    along = velocity[..., 0] * np.cos(heading) + velocity[..., 1] * np.sin(heading)
    return np.where(along < 0, -1.0, 1.0) * np.hypot(velocity[..., 0], velocity[..., 1])
