"""The format of the Waymo Open Motion Dataset (Ettinger et al. 2021): scenarios in TFRecord files.

The messages are those of scenario.proto and map.proto in github.com/waymo-research/
waymo-open-dataset; the numbers below are those of their fields.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import TracksError
from geoaim.base.limits import MAX_POSITION_M, MAX_TIME_S, refuse_damaged
from geoaim.base.world import World
from geoaim.tracks.formats import protobuf, shared
from geoaim.tracks.formats.lane_signals import LaneSignals, make_lights
from geoaim.tracks.formats.motion import compute_signed_speed
from geoaim.tracks.formats.protobuf import Fields
from geoaim.tracks.formats.tfrecord import read_records
from geoaim.tracks.lights import GREEN, RED, UNKNOWN, YELLOW, Lights
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import Tracks

NEEDED = "a TFRecord file of Waymo scenarios"
TIMES, TRACKS, ID, LIGHT_STATES, MAP_FEATURES = 1, 2, 5, 7, 8  # fields of a Scenario
TYPES = {0: "unset", 1: "vehicle", 2: "pedestrian", 3: "cyclist", 4: "other"}
OBJECTS = ("unset", "other")
# fields of an ObjectState, in the order of the columns x, y, length, width, heading, vx, vy
STATE_FIELDS = (2, 3, 5, 6, 8, 9, 10)
VALID = 11
LANE = 3  # field of a MapFeature
POLYLINE = 8  # field of a LaneCenter
# states of TrafficSignalLaneState.State; flashing ones (7 and 8) are unknown
SIGNALS = {1: RED, 2: YELLOW, 3: GREEN, 4: RED, 5: YELLOW, 6: GREEN}
MAX_LISTED = 5


def list_waymo_scenarios(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """List the ids of the scenarios in a TFRecord file.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: it is damaged, or holds no scenarios.
    """
    with refuse_damaged(path, TracksError, NEEDED):
        return tuple(name for name, _ in _read_scenarios(path))


def read_waymo(path: str | os.PathLike[str], *, scenario: str | None = None) -> Tracks:
    """Read the tracks of a scenario.

    Times are those of the file. Vehicles are cars, or trucks if longer than
    `shared.MAX_CAR_LENGTH_M`; objects that are no road users are "other". An agent's size is that
    of its first state. The plane has no CRS; its origin is near the mean position.

    Args:
        path: a TFRecord file.
        scenario: id of the scenario; None where the file has one only.

    Returns:
        The tracks.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: the file is damaged, or does not have that scenario.
    """
    fields = read_waymo_scenario(path, scenario)
    with refuse_damaged(path, TracksError, NEEDED):
        rows, world = _list_states(fields), _choose_world(fields)
    if not len(rows):
        raise TracksError(f"{Path(path)}: no state in the scenario is valid")
    rows[["length", "width"]] = shared.fill_sizes(rows)
    types = shared.name_vehicles(rows["type"], rows["length"], vehicle="vehicle")
    is_object = types.isin(OBJECTS)
    rows["type"] = types.where(is_object, shared.map_types(path, types[~is_object]))
    velocity = rows[["vx", "vy"]].to_numpy()
    rows["speed"] = compute_signed_speed(velocity, rows["heading"].to_numpy())
    rows[["x", "y"]] -= np.array(world.origin)
    return make_tracks(rows, world)


def read_waymo_lights(
    path: str | os.PathLike[str], *, scenario: str | None = None
) -> Lights | None:
    """Read the traffic lights of a scenario, one for each lane that has a signal.

    A stop line crosses the middle of its lane at the file's stop point (`make_lights`). Arrows
    count as full signals; a flashing light, and one that is not seen at a step, is unknown.

    Args:
        path: a TFRecord file.
        scenario: id of the scenario; None where the file has one only.

    Returns:
        The lights, named by their lanes, in the world of `read_waymo`; None where there are none.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: the file is damaged, or does not have that scenario.
    """
    fields = read_waymo_scenario(path, scenario)
    with refuse_damaged(path, TracksError, NEEDED):
        world = _choose_world(fields)
        return make_lights(path, _list_signals(fields), read_waymo_lanes(fields), world)


def read_waymo_scenario(path: str | os.PathLike[str], scenario: str | None = None) -> Fields:
    """Read the message of a scenario.

    Args:
        path: a TFRecord file.
        scenario: id of the scenario; None where the file has one only.

    Returns:
        The values of its fields, by the numbers of scenario.proto.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: the file is damaged, or does not have that scenario.
    """
    path, names = Path(path), []
    with refuse_damaged(path, TracksError, NEEDED):
        for name, fields in _read_scenarios(path):
            names.append(name)
            if name == scenario:
                return fields
    if scenario is None and len(names) == 1:
        return fields
    listed = ", ".join(names[:MAX_LISTED]) + (", ..." if len(names) > MAX_LISTED else "")
    wanted = "name one of them" if scenario is None else f"{scenario!r} is none of them"
    raise TracksError(f"{path} holds {len(names)} scenarios: {listed}; {wanted}")


def read_waymo_lanes(fields: Fields) -> dict[str, Float[Array, "n 2"]]:
    """Read the middles of the lanes of a scenario's message, by the lanes' ids, in metres."""
    lanes = {}
    for feature in protobuf.get_messages(fields, MAP_FEATURES):
        for lane in protobuf.get_messages(feature, LANE):
            points = _read_points(lane, POLYLINE)
            if len(points) > 1:
                lanes[str(protobuf.get_integer(feature, 1))] = points
    return lanes


def _read_scenarios(path: str | os.PathLike[str]) -> Iterator[tuple[str, Fields]]:
    """Ids and messages of the scenarios; submessages stay bytes."""
    number = 0
    for number, record in enumerate(read_records(path), 1):
        fields = protobuf.parse_message(record)
        if TIMES not in fields or TRACKS not in fields:
            raise ValueError(
                f"record {number} is no Scenario: it has no times or no tracks; take the files of "
                "the folder scenario, not of tf_example"
            )
        yield protobuf.get_text(fields, ID) or str(number), fields
    if not number:
        raise TracksError(f"{path} is empty; {NEEDED} is needed")


def _list_states(fields: Fields) -> pd.DataFrame:
    """List the valid states: columns id, type, time, x, y, length, width, heading, vx, vy."""
    times = _read_times(fields).tolist()
    rows = []
    for track in protobuf.get_messages(fields, TRACKS):
        name, number = protobuf.get_integer(track, 1), protobuf.get_integer(track, 2)
        states = protobuf.get_parts(track, 3)
        if len(states) != len(times):
            raise ValueError(f"track {name} has {len(states)} states, and {len(times)} are needed")
        kind = TYPES.get(number, f"type {number}")
        for time, part in zip(times, states, strict=True):
            state = protobuf.parse_message(part)
            if protobuf.get_integer(state, VALID):
                numbers = [protobuf.get_number(state, field) for field in STATE_FIELDS]
                rows.append((str(name), kind, time, *numbers))
    columns = ["id", "type", "time", "x", "y", "length", "width", "heading", "vx", "vy"]
    return pd.DataFrame(rows, columns=columns)


def _read_times(fields: Fields) -> Float[Array, "T"]:
    """Read the times of the steps, in seconds."""
    times = np.array(protobuf.get_numbers(fields, TIMES))
    if not (np.diff(times) > 0).all() or not (np.abs(times) <= MAX_TIME_S).all():
        raise ValueError("the times do not increase, or are no seconds")
    return times


def _choose_world(fields: Fields) -> World:
    return World(None, shared.choose_origin(_list_states(fields)[["x", "y"]].to_numpy(np.float64)))


def _list_signals(fields: Fields) -> LaneSignals:
    """List the signals that are seen at each step."""
    seen = [
        (step, protobuf.get_integer(signal, 1), protobuf.get_integer(signal, 2), *point)
        for step, part in enumerate(protobuf.get_messages(fields, LIGHT_STATES))
        for signal in protobuf.get_messages(part, 1)
        for point in _read_points(signal, 3)[:1].tolist()
    ]
    table = pd.DataFrame(seen, columns=["step", "lane", "state", "x", "y"])
    table["state"] = table["state"].map(SIGNALS).fillna(UNKNOWN).astype(np.int8)
    return LaneSignals(_read_times(fields), table.astype({"lane": str}))


def _read_points(fields: Fields, number: int) -> Float[Array, "n 2"]:
    """Read the MapPoints of a field, without their heights."""
    points = protobuf.get_messages(fields, number)
    numbers = [[protobuf.get_number(point, 1), protobuf.get_number(point, 2)] for point in points]
    array = np.array(numbers, np.float64).reshape(-1, 2)
    if not (np.abs(array) <= MAX_POSITION_M).all():
        raise ValueError("a point of the map is not in metres")
    return array


WAYMO = shared.TrackFormat(
    "Waymo Open Motion",
    lambda path, line: ".tfrecord" in path.name,
    read_waymo,
    options=("scenario",),
)
