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
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import TracksError
from geoaim.base.limits import MAX_TIME_S, refuse_damaged
from geoaim.base.pickles import read_pickle
from geoaim.base.world import World
from geoaim.tracks.formats import shared
from geoaim.tracks.formats.motion import compute_signed_speed
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import Tracks

NEEDED = "a scenario description of ScenarioNet"
OBJECTS = ("other", "unset", "traffic_barrier", "traffic_cone", "traffic_object")
WORLD_KEY = "geoaim_world"  # of the metadata in files that geoaim wrote: CRS and origin
TYPE_KEY = "geoaim_type"  # of a track's metadata there
FILES = "sd_*.pkl"  # of scenarios in a folder


def read_scenarionet(path: str | os.PathLike[str]) -> Tracks:
    """Read the tracks of a scenario, `sd_*.pkl`; nothing in the file is run (`read_pickle`).

    The path may be the folder of one scenario; its map and its lights are not read. Vehicles are
    cars, or trucks if longer than `shared.MAX_CAR_LENGTH_M`; objects that are no road users keep
    their names as types. The plane has no CRS; its origin is near the mean position. A file that
    geoaim wrote states types and CRS itself.

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
        if WORLD_KEY not in scenario["metadata"]:  # else they are relative to the origin
            rows[["x", "y"]] -= np.array(world.origin)
        return make_tracks(rows, world)


def read_scenario_description(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a scenario description, of which tracks and metadata are dicts."""
    path = Path(path)
    with refuse_damaged(path, TracksError, NEEDED):
        scenario = read_pickle(path.read_bytes())
        parts = ("tracks", "metadata")
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


def _matches(path: Path, line: str) -> bool:
    is_folder = path.is_dir() and any(path.glob(FILES))
    return is_folder or path.suffix.lower() == ".pkl"


# before SinD, which takes all folders
SCENARIONET = shared.TrackFormat("ScenarioNet", _matches, read_scenarionet, rank=-1)
