"""Speeds and headings of tracks, computed from positions where a file states none."""

from dataclasses import replace

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.world import World
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import COLUMNS, Tracks, estimate_heading

OBSERVED_WINDOW_S = 0.75  # over which observed headings and speeds are differenced


def derive_motion(tracks: Tracks, *, half_window: float) -> Tracks:
    """Replace headings and speeds by those of the positions over `half_window` seconds either side.

    Those of `observed` are of the last `OBSERVED_WINDOW_S` seconds. The velocities are those of
    `estimate_velocity`; where it gives none, speeds are 0 and `observed` is NaN. An agent that
    stands keeps the direction of its last motion; no agent drives in reverse.
    """
    velocity = np.nan_to_num(estimate_velocity(tracks, half_window, half_window))
    states = _set_motion(tracks, estimate_heading(velocity), np.hypot(*velocity.T).T)
    past = estimate_velocity(tracks, OBSERVED_WINDOW_S, 0.0)
    heading = estimate_heading(np.nan_to_num(past), causal=True)
    observed = _set_motion(tracks, heading, np.hypot(*past.T).T)
    return replace(tracks, states=states, observed=observed, observed_sigma=None)


def derive_speeds(tracks: Tracks, *, half_window: float) -> Tracks:
    """Replace speeds by those of the positions over `half_window` seconds either side.

    As `derive_motion`, but headings stay: an agent that moves against its own drives in reverse,
    and has a negative speed.
    """
    velocity = np.nan_to_num(estimate_velocity(tracks, half_window, half_window))
    past = estimate_velocity(tracks, OBSERVED_WINDOW_S, 0.0)
    heading = tracks.states[..., 2]
    states, observed = (
        _set_motion(tracks, heading, compute_signed_speed(one, heading)) for one in (velocity, past)
    )
    return replace(tracks, states=states, observed=observed, observed_sigma=None)


def _set_motion(
    tracks: Tracks, heading: Float[Array, "N T"], speed: Float[Array, "N T"]
) -> Float[Array, "N T 4"]:
    """Set headings and speeds of states; all of a state is NaN where they are not known."""
    motion = np.stack([heading, speed], axis=-1)
    states = np.concatenate([tracks.states[..., :2], motion], axis=-1)
    known = tracks.present & np.isfinite(motion).all(axis=-1)
    return np.where(known[..., None], states, np.nan)


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


def estimate_velocity(tracks: Tracks, before: float, after: float) -> Float[Array, "N T 2"]:
    """Estimate velocities (m/s) by differences of positions about each time."""
    present_agent, present_step = np.nonzero(tracks.present)
    gaps = np.diff(tracks.times[present_step])[np.diff(present_agent) == 0]
    least = 1.01 * float(np.median(gaps)) if len(gaps) else 0.0
    before, after = max(before, least), max(after, least) if after else 0.0
    velocity = np.full((*tracks.present.shape, 2), np.nan)
    for agent in range(len(tracks.ids)):
        steps = np.flatnonzero(tracks.present[agent])
        positions, times = tracks.states[agent, steps, :2], tracks.times[steps]
        first = np.searchsorted(times, times - before)
        last = np.searchsorted(times, times + after, side="right") - 1
        dt = times[last] - times[first]
        dt[(dt == 0) | (dt < (0.0 if after else before / 2))] = np.nan
        velocity[agent, steps] = (positions[last] - positions[first]) / dt[:, None]
    return velocity


def fill_headings(rows: pd.DataFrame) -> pd.DataFrame:
    """Fill NaN in the column heading: with the agent's last known one, 0 before the first."""
    headings = rows.sort_values("time").groupby("id")["heading"]
    return rows.assign(heading=headings.ffill().fillna(0.0))


def compute_signed_speed(
    velocity: Float[Array, "*m 2"], heading: Float[Array, "*m"]
) -> Float[Array, "*m"]:
    """Compute speeds from velocities (m/s), negative where these point against the heading (rad).

    >>> compute_signed_speed(np.array([[3.0, 4.0], [0.0, -2.0]]), np.array([0.0, np.pi / 2]))
    array([ 5., -2.])
    """
    along = velocity[..., 0] * np.cos(heading) + velocity[..., 1] * np.sin(heading)
    return np.where(along < 0, -1.0, 1.0) * np.hypot(velocity[..., 0], velocity[..., 1])
