"""Motion statistics of real and synthetic tracks, and the real tracks."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimWarning
from geoaim.tracks.formats import read_geotrax, read_interaction, read_sdd
from geoaim.tracks.tracks import Tracks

VEHICLES = ("car", "van", "truck", "bus")
DT = 0.1  # s between resampled positions
SMOOTH = 7  # steps of the window over which positions are averaged
MOVING_SPEED = 0.5  # m/s from which an agent moves
CURVATURE_SPEED = 2.0  # m/s from which a vehicle's curvature and headway are measured
MAX_LATERAL_OFFSET_M = 1.75  # a vehicle ahead is a leader up to this distance to either side
MAX_LEADER_DISTANCE_M = 60.0
Statistics = Mapping[str, Float[Array, "_"]]


def concat_statistics(parts: Sequence[Statistics]) -> dict[str, Float[Array, "_"]]:
    """Concatenate the same statistics of several recordings."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def read_real_vehicles(folder: Path) -> dict[str, list[Tracks]]:
    """Read the vehicle tracks of Songdo and Karlsruhe, by place."""
    tracks = {"songdo": [read_geotrax(folder / "tracks/songdo_u/U_video_cut.csv", crs="EPSG:5186")]}
    for place in sorted((folder / "tracks/karlsruhe/tracks").iterdir()):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GeoaimWarning)
            files = sorted(place.glob("vehicle_tracks_*.csv"))
            tracks[place.name[:4]] = [read_interaction(file) for file in files]
    return tracks


def read_real_pedestrians(folder: Path) -> dict[str, list[Tracks]]:
    """Read the Stanford Drone Dataset's raw tracks, at the resolutions that it estimates."""
    scales = read_sdd_resolutions(folder / "tracks/sdd_raw/estimated_scales.yaml")
    recordings: dict[str, list[Tracks]] = {}
    for path in sorted((folder / "tracks/sdd_raw").glob("*/*/annotations.txt.gz")):
        scene, video = path.parts[-3:-1]
        tracks = read_sdd(path, resolution=scales[scene, video])
        recordings.setdefault(scene, []).append(tracks)
    return recordings


def read_sdd_resolutions(path: Path) -> dict[tuple[str, str], float]:
    """Read the resolution of each scene's videos from a YAML file of three levels."""
    scales, scene, video = {}, "", ""
    for line in path.read_text().splitlines():
        key, _, value = line.strip().partition(":")
        if line and not line[0].isspace():
            scene = key
        elif key == "scale":
            scales[scene, video] = float(value)
        elif not value:
            video = key
    return scales


def measure_motion(recordings: Tracks | list[Tracks], types: tuple[str, ...]) -> Statistics:
    """Collect speeds, accelerations, curvatures and distances of agents of types, by name."""
    several = recordings if isinstance(recordings, list) else [recordings]
    return concat_statistics([_measure_recording(tracks, types) for tracks in several])


def _measure_recording(tracks: Tracks, types: tuple[str, ...]) -> dict[str, Float[Array, "_"]]:
    """Measure speeds, accelerations, curvatures and distances from smoothed positions."""
    positions = resample_positions(tracks, np.array([kind in types for kind in tracks.types]))
    velocity = np.gradient(positions, DT, axis=1)
    speed = np.hypot(velocity[..., 0], velocity[..., 1])
    acceleration = np.gradient(speed, DT, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        change = np.gradient(velocity, DT, axis=1)
        cross = velocity[..., 0] * change[..., 1] - velocity[..., 1] * change[..., 0]
        curvature = np.abs(cross) / speed**3
    is_moving, is_fast = speed > MOVING_SPEED, speed > CURVATURE_SPEED
    is_vehicle = types == VEHICLES
    is_curved = is_fast if is_vehicle else is_moving
    statistics = {
        "speed while moving, m/s": speed[is_moving],
        "share of time standing": (speed < MOVING_SPEED)[np.isfinite(speed)].astype(float),
        "acceleration, m/s2": acceleration[is_moving & np.isfinite(acceleration)],
        "curvature, 1/m": curvature[is_curved & np.isfinite(curvature)],
        "lateral acceleration, m/s2": (curvature * speed**2)[is_moving & np.isfinite(curvature)],
    }
    if is_vehicle:
        statistics |= _measure_headways(tracks)
    else:
        statistics["distance to the nearest, m"] = _measure_nearest(positions)
    return {name: np.asarray(values, float) for name, values in statistics.items()}


def resample_positions(tracks: Tracks, chosen: Bool[Array, "N"]) -> Float[Array, "n T 2"]:
    """Resample the positions of the chosen agents, averaged over `SMOOTH` steps.

    The result is (n, T, 2) metres every `DT` seconds of the recording; NaN near gaps and at the
    ends of a track.
    """
    times = np.arange(tracks.times[0], tracks.times[-1], DT)
    positions = np.full((int(chosen.sum()), len(times), 2), np.nan)
    kernel = np.ones(SMOOTH) / SMOOTH
    for row, agent in enumerate(np.flatnonzero(chosen)):
        steps = np.flatnonzero(tracks.present[agent])
        here = tracks.times[steps]
        position = np.array(
            [np.interp(times, here, tracks.states[agent, steps, k]) for k in (0, 1)]
        ).T
        gap = (
            np.interp(times, here[:-1], np.diff(here))
            if len(here) > 1
            else np.full(len(times), 9.0)
        )
        position[(times < here[0]) | (times > here[-1]) | (gap > 3 * DT)] = np.nan
        for k in (0, 1):
            positions[row, :, k] = np.convolve(position[:, k], kernel, "same")
        positions[row, : SMOOTH // 2] = positions[row, len(times) - SMOOTH // 2 :] = np.nan
    return positions


def _measure_headways(tracks: Tracks) -> dict[str, Float[Array, "_"]]:
    """Measure time gaps to leading vehicles and distances in standing queues, every second."""
    vehicle = np.array([kind in VEHICLES for kind in tracks.types])
    stride = max(round(1.0 / float(np.median(np.diff(tracks.times)))), 1)
    gaps, queues = [], []
    for step in range(0, len(tracks.times), stride):
        agents = np.flatnonzero(tracks.present[:, step] & vehicle)
        x, y, heading, speed = tracks.states[agents, step].T
        east, north = x - x[:, None], y - y[:, None]
        along = east * np.cos(heading)[:, None] + north * np.sin(heading)[:, None]
        lateral = north * np.cos(heading)[:, None] - east * np.sin(heading)[:, None]
        parallel = np.cos(heading - heading[:, None]) > 0.9
        ahead = (
            (along > 0.5)
            & (along < MAX_LEADER_DISTANCE_M)
            & (np.abs(lateral) < MAX_LATERAL_OFFSET_M)
            & parallel
        )
        along = np.where(ahead, along, np.inf)
        if len(agents) < 2:
            continue
        leader = np.argmin(along, axis=1)
        length = tracks.sizes[agents, 0]
        gap = along[np.arange(len(agents)), leader] - (length + length[leader]) / 2
        is_following = np.isfinite(gap)
        moving, standing = (
            is_following & (speed > CURVATURE_SPEED),
            is_following & (speed < 0.3) & (speed[leader] < 0.3),
        )
        gaps.append(gap[moving] / speed[moving])
        queues.append(gap[standing])
    return {
        "headway, s": np.concatenate(gaps or [np.empty(0)]),
        "distance in queues, m": np.concatenate(queues or [np.empty(0)]),
    }


def _measure_nearest(positions: Float[Array, "n T 2"]) -> Float[Array, "_"]:
    """Measure distances to the nearest agent, every second, below 10 m."""
    distances = []
    for step in range(0, positions.shape[1], 10):
        present = positions[np.isfinite(positions[:, step, 0]), step]
        if len(present) > 1:
            separation = np.hypot(*np.moveaxis(present[:, None] - present[None], -1, 0))
            np.fill_diagonal(separation, np.inf)
            nearest = separation.min(axis=1)
            distances.append(nearest[nearest < 10])
    return np.concatenate(distances or [np.empty(0)])
