"""The same tracks at another rate, or in another world."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import TracksError
from geoaim.geometry import wrap_angle
from geoaim.tracks import MOST, TICKS, Tracks
from geoaim.world import World, crs_from_world, world_from_crs


def to_world(tracks: Tracks, world: World) -> Tracks:
    """The same tracks in another world: places and headings; lengths and speeds stay.

    Raises:
        TracksError: one of the worlds has a place on the Earth, and the other has none.
    """
    if tracks.world == world:
        return tracks
    if (tracks.world.crs is None) != (world.crs is None):
        raise TracksError(
            f"the tracks lie in {tracks.world.crs or 'a plane of their own'}, and are needed in "
            f"{world.crs or 'a plane of its own'}; give both a place on the Earth, or none"
        )
    states, there = tracks.states.copy(), tracks.present
    here, heading = states[there, :2], states[there, 2]
    ahead = here + np.stack([np.cos(heading), np.sin(heading)], axis=1)
    here, ahead = (
        world_from_crs(world, crs_from_world(tracks.world, points), tracks.world.crs)
        for points in (here, ahead)
    )
    states[there, :2] = here
    states[there, 2] = np.arctan2(*(ahead - here).T[::-1])
    return replace(tracks, states=states, world=world)


def resample_tracks(tracks: Tracks, rate: float, *, gap: float = 0.5) -> Tracks:
    """The same tracks at an even rate, from their first time on.

    Between two recorded states positions and speeds are linear in time and headings turn the
    shorter way; at a recorded time the state is the recorded one. Nothing is extrapolated. Agents
    keep their order, also one who is there only between two of the new times, and so never.

    Args:
        tracks: at any times.
        rate: in Hz.
        gap: the longest time between two recorded states, in seconds, over which an agent is taken
            to be there; a longer absence stays one.

    Raises:
        ValueError: the rate is not positive or asks for too much, or the agents' usual step is
            longer than the gap, so that hardly anybody would be left.
    """
    if not 0 < rate < np.inf:
        raise ValueError(f"rate is {rate}; a positive number of Hz is needed")
    if len(tracks.times) == 0:
        return tracks
    steps = [np.diff(tracks.times[there]) for there in tracks.present]
    usual = float(np.median(np.concatenate([[], *steps]))) if any(map(len, steps)) else 0.0
    if not gap >= usual - 1 / TICKS:
        raise ValueError(f"gap is {gap} s, less than the usual step of {usual:g} s; give more")
    count = int((tracks.times[-1] - tracks.times[0]) * rate + rate / TICKS) + 1
    if count * max(len(tracks.ids), 1) > MOST:
        raise ValueError(
            f"{len(tracks.ids)} agents times {count} times are too many; lower the rate of {rate} "
            "Hz or cut the tracks"
        )
    times = tracks.times[0] + np.arange(count) / rate
    states = np.full((len(tracks.ids), count, 4), np.nan)
    for agent, there in enumerate(tracks.present):
        states[agent] = _between(tracks.times[there], tracks.states[agent, there], times, gap)
    return replace(tracks, times=times, states=states, present=np.isfinite(states[..., 0]))


def _between(
    times: Float[Array, "M"], states: Float[Array, "M 4"], wanted: Float[Array, "T"], gap: float
) -> Float[Array, "T 4"]:
    """An agent's states at other times; NaN where it is not known to be there."""
    found = np.full((len(wanted), 4), np.nan)
    before = np.searchsorted(times, wanted + 1 / TICKS, side="right") - 1
    after = np.searchsorted(times, wanted - 1 / TICKS)
    inside = np.flatnonzero((before >= 0) & (after < len(times)))
    before, after = before[inside], np.maximum(before, after)[inside]  # one, at a recorded time
    near = times[after] - times[before] <= gap + 1 / TICKS
    inside, before, after = inside[near], before[near], after[near]
    apart = np.where(after > before, times[after] - times[before], 1.0)
    share = np.where(after > before, (wanted[inside] - times[before]) / apart, 0.0)[:, None]
    change = states[after] - states[before]
    change[:, 2] = wrap_angle(change[:, 2])
    found[inside] = states[before] + share * change
    turned = np.abs(found[:, 2]) >= np.pi
    found[turned, 2] = wrap_angle(found[turned, 2])
    return found
