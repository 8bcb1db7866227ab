"""ScenarioNet's scenario descriptions (Li et al. 2023): a pickle for each scenario.

The schema is that of metadrive.scenario.scenario_description, which MetaDrive, ScenarioNet and
UniTraj share. `geoaim.hdmap.scenarionet` writes such files.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Int8
from numpy import ndarray as Array

from geoaim.base.errors import TracksError, warn
from geoaim.base.limits import MAX_POSITION_M, MAX_TIME_S, refuse_damaged
from geoaim.base.pickles import read_pickle
from geoaim.base.world import World
from geoaim.tracks.formats import shared
from geoaim.tracks.formats.motion import compute_signed_speed
from geoaim.tracks.lights import GREEN, RED, UNKNOWN, YELLOW, Lights
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import Tracks

NEEDED = "a scenario description of ScenarioNet"
OBJECTS = ("other", "unset", "traffic_barrier", "traffic_cone", "traffic_object")
# states of lights by Waymo's and MetaDrive's names; all other names are unknown
SIGNALS = {
    **dict.fromkeys(("LANE_STATE_GO", "LANE_STATE_ARROW_GO", "TRAFFIC_LIGHT_GREEN"), GREEN),
    **dict.fromkeys(("LANE_STATE_CAUTION", "LANE_STATE_ARROW_CAUTION"), YELLOW),
    **dict.fromkeys(("TRAFFIC_LIGHT_YELLOW",), YELLOW),
    **dict.fromkeys(("LANE_STATE_STOP", "LANE_STATE_ARROW_STOP", "TRAFFIC_LIGHT_RED"), RED),
}
WORLD_KEY = "geoaim_world"  # of the metadata in files that geoaim wrote: CRS and origin
TYPE_KEY = "geoaim_type"  # of a track's metadata there
FILES = "sd_*.pkl"  # of scenarios in a folder
LANE_WIDTH_M = 3.5  # which the files do not state


def read_scenarionet(path: str | os.PathLike[str]) -> Tracks:
    """Read the tracks of a scenario, `sd_*.pkl`; nothing in the file is run (`read_pickle`).

    The path may be the folder of one scenario. Vehicles are cars, or trucks if longer than
    `shared.MAX_CAR_LENGTH_M`; objects that are no road users keep their names as types. The plane
    has no CRS; its origin is near the mean position. A file that geoaim wrote states types and CRS
    itself.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: it is no such scenario, or holds what is not plain data.
    """
    path = _find_file(Path(path))
    scenario = read_scenario_description(path)
    with refuse_damaged(path, TracksError, NEEDED):
        rows, world = _list_states(scenario), _find_world(scenario)
        rows[["length", "width"]] = shared.fill_sizes(rows)
        types = shared.name_vehicles(rows["type"], rows["length"], vehicle="vehicle")
        is_object = types.isin(OBJECTS)
        rows["type"] = types.where(is_object, shared.map_types(path, types[~is_object]))
        rows[["x", "y"]] -= _find_offset(scenario, world)
        return make_tracks(rows, world)


def read_scenarionet_lights(path: str | os.PathLike[str]) -> Lights | None:
    """Read the traffic lights of a scenario, one for each lane that has a signal.

    A stop line crosses the middle of its lane at the file's stop point, `LANE_WIDTH_M` wide. Arrows
    count as full signals; a flashing light, and one that is not seen at a step, is unknown. The
    world is that of `read_scenarionet`.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: as in `read_scenarionet`.
    """
    path = _find_file(Path(path))
    scenario = read_scenario_description(path)
    with refuse_damaged(path, TracksError, NEEDED):
        world, times = _find_world(scenario), _read_times(scenario)
        middles, signals = _list_middles(scenario), _list_signals(scenario, len(times))
        lanes = [lane for lane in signals if lane in middles]
        if missing := len(signals) - len(lanes):
            warn(f"{path}: {missing} signals are left out, whose lanes the map does not have")
        if not lanes:
            return None
        lines = np.array([_cross_lane(signals[lane][1], middles[lane]) for lane in lanes])
        lines -= _find_offset(scenario, world)
        if not (np.abs(lines) <= MAX_POSITION_M).all():
            raise ValueError(f"a light lies {np.abs(lines).max():g} m from the tracks")
        states = np.column_stack([signals[lane][0] for lane in lanes])
        return Lights(tuple(lanes), lines, times, states, world)


def read_scenario_description(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a scenario description, of which tracks, map and metadata are dicts."""
    path = Path(path)
    with refuse_damaged(path, TracksError, NEEDED):
        scenario = read_pickle(path.read_bytes())
        parts = ("tracks", "map_features", "dynamic_map_states", "metadata")
        if not isinstance(scenario, dict):
            raise ValueError(f"it holds a {type(scenario).__name__}")
        missing = [name for name in parts if not isinstance(scenario.get(name), dict)]
        if missing:
            raise ValueError(f"it has no {', '.join(missing)}; is it a summary of a dataset?")
    return scenario


def _find_file(path: Path) -> Path:
    """Find the scenario in a folder, as `write_scenarionet` writes it; a file is itself."""
    if not path.is_dir():
        return path
    files = sorted(path.glob(FILES))
    if len(files) != 1:
        raise TracksError(f"{path} has {len(files)} scenarios {FILES}; give one of these files")
    return files[0]


def _read_times(scenario: Mapping[str, Any]) -> Float[Array, "T"]:
    times = np.asarray(scenario["metadata"]["ts"], np.float64)
    in_order = times.ndim == 1 and len(times) > 0 and (np.diff(times) > 0).all()
    if not in_order or not (np.abs(times) <= MAX_TIME_S).all():
        raise ValueError("its time stamps do not increase, or are no seconds")
    return times


def _list_states(scenario: Mapping[str, Any]) -> pd.DataFrame:
    """List the valid states as rows for `make_tracks`, in the file's plane."""
    times = np.round(_read_times(scenario), 4)  # float32 in the files of others
    parts = []
    for name, track in scenario["tracks"].items():
        state, count = track["state"], len(times)
        position = _read_array(state, "position", count, 2)
        heading = _read_array(state, "heading", count, 1)[:, 0]
        velocity = _read_array(state, "velocity", count, 2)
        sizes = [
            _read_array(state, key, count, 1)[:, 0] if key in state else np.full(count, np.nan)
            for key in ("length", "width")
        ]
        valid = _read_array(state, "valid", count, 1)[:, 0] > 0
        columns = {"time": times, "x": position[:, 0], "y": position[:, 1], "heading": heading}
        columns |= {"speed": compute_signed_speed(velocity, heading)}
        columns |= {"length": sizes[0], "width": sizes[1]}
        part = pd.DataFrame(columns)[valid]
        stated = track.get("metadata", {}).get(TYPE_KEY) or str(track["type"]).lower()
        parts.append(part.assign(id=str(name), type=str(stated)))
    if not sum(map(len, parts)):
        raise ValueError("no state in it is valid")
    return pd.concat([part for part in parts if len(part)], ignore_index=True)


def _read_array(
    state: Mapping[str, Any], key: str, count: int, width: int
) -> Float[Array, "T width"]:
    """Read the first columns of an array of a track's state, with a row for each time."""
    array = np.asarray(state[key], np.float64)
    array = array.reshape(len(array), -1)
    if len(array) != count or array.shape[1] < width:
        raise ValueError(
            f"a {key} has {len(array)} rows of {array.shape[1]}; {count} of {width} are needed"
        )
    return array[:, :width]


def _find_world(scenario: Mapping[str, Any]) -> World:
    stated = scenario["metadata"].get(WORLD_KEY)
    if stated is not None:
        east, north = map(float, stated["origin"])
        return World(stated["crs"], (east, north))
    return World(None, shared.choose_origin(_list_states(scenario)[["x", "y"]].to_numpy()))


def _find_offset(scenario: Mapping[str, Any], world: World) -> Float[Array, "2"]:
    """The world's origin in the file's plane: files that geoaim wrote are relative to it."""
    is_relative = WORLD_KEY in scenario["metadata"]
    return np.zeros(2) if is_relative else np.array(world.origin)


def _list_middles(scenario: Mapping[str, Any]) -> dict[str, Float[Array, "n 2"]]:
    """List the points along the middle of each lane, in the file's plane."""
    return {
        str(name): _read_points(feature["polyline"])
        for name, feature in scenario["map_features"].items()
        if str(feature.get("type", "")).startswith("LANE_") and len(feature["polyline"]) > 1
    }


def _list_signals(
    scenario: Mapping[str, Any], count: int
) -> dict[str, tuple[Int8[Array, "T"], Float[Array, "2"]]]:
    """List the states of each lane's light at each of `count` times, and its stop point."""
    signals: dict[str, tuple[Int8[Array, T], Float[Array, 2]]] = {}
    for name, light in scenario["dynamic_map_states"].items():
        states = light["state"]["object_state"]
        if len(states) > count:
            raise ValueError(f"a light has {len(states)} states for {count} times")
        lane, point = str(light.get("lane") or name), _read_points([light["stop_point"]])[0]
        shown = signals.setdefault(lane, (np.full(count, UNKNOWN, np.int8), point))[0]
        shown[: len(states)] = [SIGNALS.get(str(state), UNKNOWN) for state in states]
    return signals


def _cross_lane(point: Float[Array, "2"], middle: Float[Array, "n 2"]) -> Float[Array, "2 2"]:
    """Make the line across a lane at a point: from its right to its left."""
    nearest = int(np.linalg.norm(middle - point, axis=1).argmin())
    start = min(nearest, len(middle) - 2)
    along = middle[start + 1] - middle[start]
    left = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-9)
    return np.stack([point - LANE_WIDTH_M / 2 * left, point + LANE_WIDTH_M / 2 * left])


def _read_points(points: Any) -> Float[Array, "n 2"]:
    array = np.asarray(points, np.float64)[:, :2]
    if not (np.abs(array) <= MAX_POSITION_M).all():
        raise ValueError("a point of the map is not in metres")
    return array


def _matches(path: Path, line: str) -> bool:
    is_folder = path.is_dir() and any(path.glob(FILES))
    return is_folder or path.suffix.lower() == ".pkl"


# before SinD, which takes all folders
SCENARIONET = shared.TrackFormat("ScenarioNet", _matches, read_scenarionet, rank=-1)
