"""Tracks resampled to another rate or transformed to another world."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import TracksError
from geoaim.geometry import wrap_angle
from geoaim.tracks import MAX_STATES, TICKS_PER_S, Tracks
from geoaim.world import World, change_world


def to_world(tracks: Tracks, world: World) -> Tracks:
    """Transform tracks to another world: positions and headings; sizes and speeds stay.

    Raises:
        TracksError: only one of the two worlds has a CRS.
    """
    if tracks.world == world:
        return tracks
    if (tracks.world.crs is None) != (world.crs is None):
        there, here = (w.crs or "a local plane without a CRS" for w in (tracks.world, world))
        raise TracksError(
            f"the tracks lie in {there}, and are needed in {here}; give both a CRS, or neither"
        )
    states, present = tracks.states.copy(), tracks.present
    position, heading = states[present, :2], states[present, 2]
    ahead = position + np.stack([np.cos(heading), np.sin(heading)], axis=1)
    position, ahead = (change_world(tracks.world, world, points) for points in (position, ahead))
    states[present, :2] = position
    states[present, 2] = np.arctan2(*(ahead - position).T[::-1])
    return replace(tracks, states=states, world=world)


def resample_tracks(tracks: Tracks, rate: float, *, max_gap: float = 0.5) -> Tracks:
    """Resample tracks at an even rate, from their first time on.

    Positions and speeds are interpolated linearly in time, headings along the shorter turn; at a
    recorded time, the recorded state is kept. Nothing is extrapolated.

    Args:
        tracks: at any times.
        rate: in Hz.
        max_gap: seconds; an agent is absent between recorded states that are further apart.

    Returns:
        Tracks at the new times, with all agents. An agent without a state at any new time is kept,
        as absent.

    Raises:
        ValueError: the rate is not positive.
        TracksError: there would be too many states, or more than half of all recorded states are
            further than `max_gap` from the agent's next one.
    """
    if not 0 < rate < np.inf:
        raise ValueError(f"rate is {rate}; a positive number of Hz is needed")
    if len(tracks.times) == 0:
        return tracks
    _check_gap(tracks, max_gap)
    steps = int((tracks.times[-1] - tracks.times[0]) * rate + rate / TICKS_PER_S) + 1
    if steps * max(len(tracks.ids), 1) > MAX_STATES:
        raise TracksError(
            f"{len(tracks.ids):,} agents at {steps:,} steps, from {tracks.times[0]:g} to "
            f"{tracks.times[-1]:g} s at {rate:g} Hz, exceed {MAX_STATES:,} states; cut the tracks"
        )
    times = tracks.times[0] + np.arange(steps) / rate
    states = np.full((len(tracks.ids), steps, 4), np.nan)
    for agent, present in enumerate(tracks.present):
        recorded = tracks.times[present], tracks.states[agent, present]
        states[agent] = _interpolate(*recorded, times, max_gap)
    return replace(tracks, times=times, states=states, present=np.isfinite(states[..., 0]))


def _check_gap(tracks: Tracks, max_gap: float) -> None:
    """Refuse a gap below the median time between an agent's recorded states."""
    dts = np.concatenate([[], *(np.diff(tracks.times[present]) for present in tracks.present)])
    dt = float(np.median(dts)) if len(dts) else 0.0
    if not max_gap >= dt - 1 / TICKS_PER_S:
        raise TracksError(
            f"the agents' states are {dt:g} s apart (median), and gaps of up to {max_gap:g} s are "
            "filled; give tracks with more states, or a larger max_gap in Python"
        )


def _interpolate(
    times: Float[Array, "M"], states: Float[Array, "M 4"], at: Float[Array, "T"], max_gap: float
) -> Float[Array, "T 4"]:
    """Interpolate an agent's states at other times; NaN where it is absent."""
    tick = 1 / TICKS_PER_S
    interpolated = np.full((len(at), 4), np.nan)
    before = np.searchsorted(times, at + tick, side="right") - 1
    after = np.searchsorted(times, at - tick)
    inside = np.flatnonzero((before >= 0) & (after < len(times)))
    before, after = before[inside], np.maximum(before, after)[inside]  # equal at a recorded time
    near = times[after] - times[before] <= max_gap + tick
    inside, before, after = inside[near], before[near], after[near]
    dt = np.where(after > before, times[after] - times[before], 1.0)
    weight = np.where(after > before, (at[inside] - times[before]) / dt, 0.0)[:, None]
    change = states[after] - states[before]
    change[:, 2] = wrap_angle(change[:, 2])
    interpolated[inside] = states[before] + weight * change
    unwrapped = np.abs(interpolated[:, 2]) >= np.pi
    interpolated[unwrapped, 2] = wrap_angle(interpolated[unwrapped, 2])
    return interpolated
