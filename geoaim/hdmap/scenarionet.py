"""Scenarios written for ScenarioNet, MetaDrive and UniTraj, with the lanes of an HD map.

The schema is that of metadrive.scenario.scenario_description; `read_scenarionet` reads it.
"""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import LineString

from geoaim.base.errors import TracksError, warn
from geoaim.base.files import atomic_folder
from geoaim.base.pickles import write_pickle
from geoaim.base.world import World, change_world
from geoaim.hdmap.drivable import sample_borders
from geoaim.hdmap.lanelet2 import HDMap, Lanelet
from geoaim.tracks.agent_types import AGENT_GROUPS
from geoaim.tracks.formats.scenarionet import TYPE_KEY, WORLD_KEY
from geoaim.tracks.lights import GREEN, RED, YELLOW, Lights, find_light_states
from geoaim.tracks.tracks import Tracks

LANES = {"bicycle_lane": "LANE_BIKE_LANE", "bikelane": "LANE_BIKE_LANE"}
AREAS = {"crosswalk": "CROSSWALK", "walkway": "ROAD_EDGE_SIDEWALK"}
EDGES = ("curbstone", "road_border", "guard_rail")
MAX_JOINT_M = 0.5  # largest distance between the end of a lane and the beginning of the next


def make_map_features(hdmap: HDMap, world: World) -> dict[str, dict[str, Any]]:
    """Make ScenarioNet's map features of an HD map, in a world."""

    def move(points: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
        moved = change_world(hdmap.world, world, points)
        return np.column_stack([moved, np.zeros(len(moved))])

    features: dict[str, dict[str, Any]] = {}
    driven = {}
    for number, lanelet in enumerate(hdmap.lanelets):
        outline = move(np.concatenate([lanelet.left, lanelet.right[::-1]]))
        if lanelet.subtype in AREAS:
            features[f"area-{number}"] = {"type": AREAS[lanelet.subtype], "polygon": outline}
        elif lanelet.subtype != "stairs":
            driven[f"lane-{number}"] = lanelet
            features[f"lane-{number}"] = {
                "type": LANES.get(lanelet.subtype, "LANE_SURFACE_STREET"),
                "polyline": move(_sample_middle(lanelet)),
                "polygon": outline,
                "left_neighbor": [],
                "right_neighbor": [],
                "left_boundaries": [],
                "right_boundaries": [],
            }
    for key, (entries, exits) in _connect_lanes(driven).items():
        features[key] |= {"entry_lanes": entries, "exit_lanes": exits}
    for number, line in enumerate(hdmap.lines):
        kind = "ROAD_EDGE_BOUNDARY" if line.kind in EDGES else None
        if line.kind in ("line_thin", "line_thick"):
            style = "BROKEN" if line.subtype == "dashed" else "SOLID"
            kind = f"ROAD_LINE_{style}_SINGLE_WHITE"
        if kind is not None and len(line.points) > 1:
            features[f"line-{number}"] = {"type": kind, "polyline": move(line.points)}
    return features


def _sample_middle(lanelet: Lanelet) -> Float[Array, "n 2"]:
    length = max(LineString(line).length for line in (lanelet.left, lanelet.right))
    # a point each 2 m
    shares = np.linspace(0, 1, max(2, int(np.ceil(length / 2.0)) + 1))
    return sample_borders(lanelet, shares).mean(axis=0)


def _connect_lanes(lanes: Mapping[str, Lanelet]) -> dict[str, tuple[list[str], list[str]]]:
    """Lanes before and after each lane: those whose borders meet its own."""
    begins = {key: np.stack([lane.left[0], lane.right[0]]) for key, lane in lanes.items()}
    ends = {key: np.stack([lane.left[-1], lane.right[-1]]) for key, lane in lanes.items()}

    def find_near(
        wanted: Float[Array, "2 2"], places: Mapping[str, Float[Array, "2 2"]]
    ) -> list[str]:
        return [key for key, place in places.items() if np.abs(place - wanted).max() < MAX_JOINT_M]

    return {key: (find_near(begins[key], ends), find_near(ends[key], begins)) for key in lanes}


VERSION = "1.0"
DT_S = 0.1  # which MetaDrive and UniTraj take for granted
VEHICLES = AGENT_GROUPS["vehicle"]
TYPES = {
    **dict.fromkeys(VEHICLES, "VEHICLE"),
    "pedestrian": "PEDESTRIAN",
    "cyclist": "CYCLIST",
    "motorcycle": "CYCLIST",
}
# metres, typical: tracks have no heights
HEIGHTS = {"car": 1.5, "van": 2.0, "truck": 3.2, "bus": 3.2}
STATES = {GREEN: "LANE_STATE_GO", YELLOW: "LANE_STATE_CAUTION", RED: "LANE_STATE_STOP"}


def write_scenarionet(
    tracks: Tracks,
    folder: str | os.PathLike[str],
    *,
    hdmap: HDMap | None = None,
    lights: Lights | None = None,
    ego: str | None = None,
) -> None:
    """Write a scenario as a new folder: `sd_geoaim_*.pkl`, a summary and a mapping.

    Args:
        tracks: tracks at 10 Hz (`geoaim.tracks.changes.resample_tracks`) that make one scenario,
            since MetaDrive loads all of it.
        folder: a new one; its name is the scenario's id.
        hdmap: its lanes, markings and crossings. Without it, MetaDrive cannot drive the scenario.
        lights: traffic lights; those whose stop lines cross no lane of the map are left out, with a
            warning.
        ego: id of the agent that MetaDrive lets one drive; None: the vehicle that is present the
            longest from the first step on.

    Raises:
        ValueError: the folder exists and is not empty.
        TracksError: the tracks are not at 10 Hz, or the ego is not present at the first step.
        GeoreferenceError: the map or the lights lie in another world that cannot be transformed.
    """
    if (np.abs(np.diff(tracks.times) - DT_S) > DT_S / 100).any():
        raise TracksError(
            "the tracks are not at 10 Hz throughout, which MetaDrive and UniTraj take for granted; "
            "resample them: geoaim.tracks.changes.resample_tracks(tracks, 10)"
        )
    folder = Path(folder)
    name = re.sub(r"\W", "-", folder.name)
    features = {} if hdmap is None else make_map_features(hdmap, tracks.world)
    scenario = {
        "id": name,
        "version": VERSION,
        "length": len(tracks.times),
        "tracks": {agent: _describe_track(tracks, row) for row, agent in enumerate(tracks.ids)},
        "dynamic_map_states": _describe_lights(lights, tracks, features),
        "map_features": features,
        "metadata": _describe_scenario(tracks, name, ego),
    }
    file = f"sd_geoaim_{VERSION}_{name}.pkl"
    with atomic_folder(folder) as temporary:
        (temporary / file).write_bytes(write_pickle(scenario))
        summary = {file: scenario["metadata"]}
        (temporary / "dataset_summary.pkl").write_bytes(write_pickle(summary))
        (temporary / "dataset_mapping.pkl").write_bytes(write_pickle({file: ""}))


def _describe_track(tracks: Tracks, row: int) -> dict[str, Any]:
    """A track's state and metadata; all numbers are 0 while the agent is absent."""
    present, kind, name = tracks.present[row], tracks.types[row], tracks.ids[row]
    states = np.where(present[:, None], tracks.states[row], 0.0)
    heading, speed = states[:, 2], states[:, 3]
    ones = present.astype(np.float64)
    metadata = {"type": TYPES.get(kind, "OTHER"), "object_id": name, "track_length": len(present)}
    return {
        "type": metadata["type"],
        "state": {
            "position": np.column_stack([states[:, :2], np.zeros(len(present))]),
            "heading": heading,
            "velocity": speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)]),
            "valid": present,
            "length": ones * tracks.sizes[row, 0],
            "width": ones * tracks.sizes[row, 1],
            "height": ones * HEIGHTS.get(kind, 1.7),
        },
        "metadata": {**metadata, "dataset": "geoaim", TYPE_KEY: kind},
    }


def _describe_scenario(tracks: Tracks, name: str, ego: str | None) -> dict[str, Any]:
    ego = _choose_ego(tracks) if ego is None else ego
    if ego not in tracks.ids or not tracks.present[tracks.ids.index(ego), 0]:
        raise TracksError(
            f"agent {ego!r} is not present at {tracks.times[0]:g} s, the first step, where "
            "MetaDrive starts it; name another ego, or cut the tracks where it enters"
        )
    return {
        "id": name,
        "scenario_id": name,
        "dataset": "geoaim",
        "source_file": name,
        "coordinate": "metadrive",
        "metadrive_processed": False,
        "ts": tracks.times - tracks.times[0],
        "sample_rate": DT_S,
        "sdc_id": ego,
        "sdc_track_index": tracks.ids.index(ego),
        # as in Waymo's scenarios, in which prediction starts after 11 steps
        "current_time_index": min(11, len(tracks.times)) - 1,
        "object_summary": {agent: _sum_up(tracks, row) for row, agent in enumerate(tracks.ids)},
        WORLD_KEY: {"crs": tracks.world.crs, "origin": list(map(float, tracks.world.origin))},
    }


def _choose_ego(tracks: Tracks) -> str:
    """The vehicle that is present the longest, of those at the first step."""
    starts = tracks.present[:, 0] & np.isin(tracks.types, VEHICLES)
    if not starts.any():
        raise TracksError(
            "no vehicle is present at the first step, where MetaDrive starts one; cut the tracks "
            "where one enters"
        )
    return tracks.ids[int(np.where(starts, tracks.present.sum(axis=1), -1).argmax())]


def _sum_up(tracks: Tracks, row: int) -> dict[str, Any]:
    """ScenarioNet's summary of a track."""
    present = tracks.present[row]
    points = tracks.states[row, present, :2]
    gaps = np.flatnonzero(np.diff(np.flatnonzero(present)) > 1)
    return {
        "type": TYPES.get(tracks.types[row], "OTHER"),
        "object_id": tracks.ids[row],
        "track_length": len(present),
        "moving_distance": float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()),
        "valid_length": len(points),
        "continuous_valid_length": int(gaps[0]) + 1 if len(gaps) else len(points),
    }


def _describe_lights(
    lights: Lights | None, tracks: Tracks, features: Mapping[str, Mapping[str, Any]]
) -> dict[str, dict[str, Any]]:
    """The lights of each lane that a stop line crosses; of several in a lane, the first one."""
    if lights is None:
        return {}
    shown = find_light_states(lights, tracks.times)
    lanes = {key: LineString(x["polyline"]) for key, x in features.items() if key[:4] == "lane"}
    found: dict[str, dict[str, Any]] = {}
    missed = []
    for number, (name, line) in enumerate(zip(lights.names, lights.lines, strict=True)):
        ends = LineString(change_world(lights.world, tracks.world, line))
        crossed = {
            key: lane.intersection(ends) for key, lane in lanes.items() if lane.crosses(ends)
        }
        missed += [] if crossed else [name]
        for key, place in crossed.items():
            states = [
                STATES.get(state, "LANE_STATE_UNKNOWN") for state in shown[:, number].tolist()
            ]
            metadata = {"type": "TRAFFIC_LIGHT", "object_id": key, "track_length": len(states)}
            light = {"type": "TRAFFIC_LIGHT", "state": {"object_state": states}, "lane": key}
            point = np.array([place.centroid.x, place.centroid.y, 0.0])
            found.setdefault(key, {**light, "stop_point": point, "metadata": metadata})
    if missed:
        warn(f"lights {', '.join(missed)} are left out: their stop lines cross no lane of the map")
    return found
