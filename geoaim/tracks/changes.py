"""Tracks resampled to another rate, cut to a time, merged or transformed to another world."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray as Array

from geoaim.base.errors import TracksError
from geoaim.base.geometry import wrap_angle
from geoaim.base.world import World, change_world
from geoaim.tracks.tracks import MAX_STATES, STATED, TICKS_PER_S, Tracks, describe_times

MAX_GAP_S = 0.5  # between states of an agent, that is filled unless another one is asked for


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
            f"the tracks lie in {there}, and are needed in {here}; give both a CRS "
            "(--tracks-world EPSG:n), or neither"
        )
    states = _transform_states(tracks.states, tracks.world, world)
    observed = tracks.observed
    if observed is not None:
        observed = _transform_states(observed, tracks.world, world)
    return replace(tracks, states=states, observed=observed, world=world)


def _transform_states(
    states: Float[Array, "N T 4"], source: World, world: World
) -> Float[Array, "N T 4"]:
    """Transform positions and headings from a world to another one."""
    states, known = states.copy(), np.isfinite(states[..., 0])
    position, heading = states[known, :2], states[known, 2]
    ahead = position + np.stack([np.cos(heading), np.sin(heading)], axis=1)
    position, ahead = (change_world(source, world, points) for points in (position, ahead))
    states[known, :2] = position
    states[known, 2] = np.arctan2(*(ahead - position).T[::-1])
    return states


def cut_tracks(tracks: Tracks, start: float, duration: float) -> Tracks:
    """Cut tracks to the steps of a time (s, both ends are kept) and the agents present in it.

    Raises:
        TracksError: no agent is present in that time.
    """
    tick = 1 / TICKS_PER_S
    steps = (tracks.times >= start - tick) & (tracks.times <= start + duration + tick)
    if not tracks.present[:, steps].any():
        raise TracksError(
            f"no agent is present from {start:g} to {start + duration:g} s; the tracks have "
            f"{describe_times(tracks.times)}"
        )
    return select_steps(tracks, steps)


def select_steps(tracks: Tracks, steps: Bool[Array, "T"] | Int[Array, " t"]) -> Tracks:
    """Select some times, and the agents that are present at any of them."""
    agents = np.flatnonzero(tracks.present[:, steps].any(axis=1))
    return Tracks(
        times=tracks.times[steps],
        states=tracks.states[agents][:, steps],
        present=tracks.present[agents][:, steps],
        sizes=tracks.sizes[agents],
        types=tuple(tracks.types[agent] for agent in agents),
        ids=tuple(tracks.ids[agent] for agent in agents),
        world=tracks.world,
        **{
            name: None if (value := getattr(tracks, name)) is None else value[agents][:, steps]
            for name in STATED
        },
    )


def select_agents(tracks: Tracks, kept: Bool[Array, "N"]) -> Tracks:
    """Select some agents, at all times; long tracks stay in rows (`Tracks.from_rows`)."""
    chosen, numbers = kept[np.nonzero(tracks.present)[0]], np.flatnonzero(kept)
    rows = {name: tracks.get_rows(name) for name in ("states", *STATED)}
    return Tracks.from_rows(
        tracks.present[numbers],
        {name: values[chosen] for name, values in rows.items() if values is not None},
        times=tracks.times,
        sizes=tracks.sizes[numbers],
        types=tuple(tracks.types[number] for number in numbers),
        ids=tuple(tracks.ids[number] for number in numbers),
        world=tracks.world,
    )


def merge_tracks(parts: Sequence[Tracks]) -> Tracks:
    """Merge tracks of one place and clock, such as files of vehicles and of pedestrians.

    Args:
        parts: one or more tracks.

    Returns:
        Tracks of all agents at all times, in the world of the first ones; an agent is absent at
        times of other parts alone, which resampling fills. An id that an earlier part has becomes
        "2-ID" in the second part, and so on. `seen`, `uncertainty` and `observed_sigma` are kept
        where all parts state them.

    Raises:
        TracksError: only some have a CRS, they share no time, or there would be too many states.
        ValueError: there are none.
    """
    if not parts:
        raise ValueError("no tracks to merge")
    parts = [parts[0], *(to_world(part, parts[0].world) for part in parts[1:])]
    _check_overlap(parts)
    ticks = [np.round(part.times * TICKS_PER_S).astype(np.int64) for part in parts]
    every, first = np.unique(np.concatenate(ticks), return_index=True)
    count = sum(len(part.ids) for part in parts)
    if count * len(every) > MAX_STATES:
        raise TracksError(
            f"{count:,} agents at {len(every):,} times exceed {MAX_STATES:,} states; cut the tracks"
        )
    columns = [np.searchsorted(every, own) for own in ticks]

    def spread(values: Sequence[Shaped[Array, "_ _ ..."]], fill: float | bool) -> Array:
        wide = []
        for one, own in zip(values, columns, strict=True):
            row = np.full((len(one), len(every), *one.shape[2:]), fill, one.dtype)
            row[:, own] = one
            wide.append(row)
        return np.concatenate(wide)

    seen = [part.seen for part in parts if part.seen is not None]
    uncertainty = [part.uncertainty for part in parts if part.uncertainty is not None]
    sigma = [part.observed_sigma for part in parts if part.observed_sigma is not None]
    derived = any(part.observed is not None for part in parts)
    return Tracks(
        times=np.concatenate([part.times for part in parts])[first],
        states=spread([part.states for part in parts], np.nan),
        present=spread([part.present for part in parts], False),
        sizes=np.concatenate([part.sizes for part in parts]),
        types=tuple(kind for part in parts for kind in part.types),
        ids=_make_unique(parts),
        world=parts[0].world,
        observed=spread([part.get_observed() for part in parts], np.nan) if derived else None,
        seen=spread(seen, False) if len(seen) == len(parts) else None,
        uncertainty=spread(uncertainty, np.nan) if len(uncertainty) == len(parts) else None,
        observed_sigma=spread(sigma, np.nan) if len(sigma) == len(parts) else None,
    )


def _check_overlap(parts: Sequence[Tracks]) -> None:
    """Refuse tracks of other times than the first ones: they are of another clock or recording."""
    spans = [(part.times[0], part.times[-1]) for part in parts if len(part.times)]
    for number, (start, end) in enumerate(spans[1:], 2):
        if start > spans[0][1] or end < spans[0][0]:
            raise TracksError(
                f"the first tracks are from {spans[0][0]:g} to {spans[0][1]:g} s, and those of "
                f"file {number} from {start:g} to {end:g} s; give files of one recording"
            )


def _make_unique(parts: Sequence[Tracks]) -> tuple[str, ...]:
    """The ids of all parts; one that is taken gets the number of its part."""
    ids: dict[str, None] = {}
    for number, part in enumerate(parts, 1):
        for name in part.ids:
            while name in ids:
                name = f"{number}-{name}"
            ids[name] = None
    return tuple(ids)


def resample_tracks(tracks: Tracks, rate: float, *, max_gap: float = MAX_GAP_S) -> Tracks:
    """Resample tracks at an even rate, from their first time on.

    Positions and speeds are interpolated linearly in time, headings along the shorter turn; at a
    recorded time, the recorded state is kept. Nothing is extrapolated but observed states, which
    know no later row: between rows, the last one moves on at its speed and heading.

    Args:
        tracks: tracks with any time steps.
        rate: states per second, Hz.
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
    states, observed = np.full((2, len(tracks.ids), steps, 4), np.nan)
    sigma = None if tracks.observed_sigma is None else np.full(states.shape[:2], np.nan)
    for agent, present in enumerate(tracks.present):
        recorded, known = tracks.states[agent, present], tracks.get_observed()[agent, present]
        states[agent] = _interpolate(tracks.times[present], recorded, times, max_gap)
        here = np.isfinite(states[agent, :, 0])
        last = _find_last(tracks.times[present], times[here])
        observed[agent, here] = _move_on(tracks.times[present], known, times[here], last)
        if sigma is not None and tracks.observed_sigma is not None:
            sigma[agent, here] = tracks.observed_sigma[agent, present][last]
    present = np.isfinite(states[..., 0])
    seen, uncertainty = _resample_certainty(tracks, times, present)
    return replace(
        tracks,
        times=times,
        states=states,
        present=present,
        observed=observed,
        seen=seen,
        uncertainty=uncertainty,
        observed_sigma=sigma,
    )


def _resample_certainty(
    tracks: Tracks, times: Float[Array, "T"], present: Bool[Array, "N T"]
) -> tuple[Bool[Array, "N T"] | None, Float[Array, "N T 2"] | None]:
    """Take what the less certain one of the recorded states before and after each time states."""
    seen, uncertainty = np.zeros(present.shape, bool), np.full((*present.shape, 2), np.nan)
    for agent, here in enumerate(present):
        recorded = np.flatnonzero(tracks.present[agent])
        known, tick = tracks.times[recorded], 1 / TICKS_PER_S
        before = recorded[np.searchsorted(known, times[here] + tick, side="right") - 1]
        after = recorded[np.minimum(np.searchsorted(known, times[here] - tick), len(known) - 1)]
        if tracks.seen is not None:
            seen[agent, here] = tracks.seen[agent, before] & tracks.seen[agent, after]
        if tracks.uncertainty is not None:
            one, other = tracks.uncertainty[agent, before], tracks.uncertainty[agent, after]
            uncertainty[agent, here] = np.maximum(one, other)
    return (
        None if tracks.seen is None else seen,
        None if tracks.uncertainty is None else uncertainty,
    )


def _check_gap(tracks: Tracks, max_gap: float) -> None:
    """Refuse a gap below the median time between an agent's recorded states."""
    dts = np.concatenate([[], *(np.diff(tracks.times[present]) for present in tracks.present)])
    dt = float(np.median(dts)) if len(dts) else 0.0
    if not max_gap >= dt - 1 / TICKS_PER_S:
        raise TracksError(
            f"the agents' states are {dt:g} s apart (median), and gaps of up to {max_gap:g} s are "
            "filled; give tracks with more states, or a larger max_gap in Python"
        )


def _find_last(times: Float[Array, "M"], at: Float[Array, "T"]) -> Int[Array, "T"]:
    """Find the last row until each time."""
    return np.searchsorted(times, at + 1 / TICKS_PER_S, side="right") - 1


def _move_on(
    times: Float[Array, "M"],
    states: Float[Array, "M 4"],
    at: Float[Array, "T"],
    last: Int[Array, "T"],
) -> Float[Array, "T 4"]:
    """Move the last state until each time on to that time, at its speed and heading."""
    moved, dt = states[last], at - times[last]
    distance = np.nan_to_num(moved[:, 3]) * np.where(dt > 1 / TICKS_PER_S, dt, 0.0)
    moved[:, 0] += distance * np.cos(moved[:, 2])
    moved[:, 1] += distance * np.sin(moved[:, 2])
    return moved


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
