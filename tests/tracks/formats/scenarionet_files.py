"""Scenario descriptions as other converters of ScenarioNet write them."""

import pickle

import numpy as np

STEPS = 11


def make_track(name: str, kind: str, x: float, *, length: float, columns: bool = False) -> dict:
    """A track that moves east at 5 m/s; it is absent in the last step."""
    valid = np.arange(STEPS) < STEPS - 1
    position = np.zeros((STEPS, 3), np.float32)
    position[:, :2] = np.column_stack([x + 0.5 * np.arange(STEPS), np.full(STEPS, -900.0)])
    sizes = np.full((STEPS, 1) if columns else STEPS, length, np.float32)
    state = {
        "position": position * valid[:, None],
        "heading": np.zeros(STEPS, np.float32),
        "velocity": np.tile(np.float32([5.0, 0.0]), (STEPS, 1)) * valid[:, None],
        "valid": valid.astype(np.float32),
        "length": sizes,
        "width": sizes / 2.5,
    }
    metadata = {"type": kind, "object_id": name, "track_length": STEPS}
    return {"type": kind, "state": state, "metadata": metadata}


def make_scenario(**changes) -> dict:
    """Two vehicles, a cone, a lane and its light, which turns green in step 5."""
    states = ["LANE_STATE_STOP"] * 5 + ["LANE_STATE_GO"] * 5 + [None]
    light = {
        "type": "TRAFFIC_LIGHT",
        "state": {"object_state": states},
        "lane": "219",
        "stop_point": np.float32([410, -900, 0]),
        "metadata": {"type": "TRAFFIC_LIGHT", "object_id": "219", "track_length": STEPS},
    }
    lane = np.column_stack([400.0 + 5 * np.arange(6), np.full(6, -900.0), np.zeros(6)])
    return {
        "id": "0",
        "version": "v0.1",
        "length": STEPS,
        "tracks": {
            "7": make_track("7", "VEHICLE", 400.0, length=4.5),
            "8": make_track("8", "VEHICLE", 430.0, length=12.0, columns=True),
            "9": make_track("9", "TRAFFIC_CONE", 450.0, length=0.5),
        },
        "dynamic_map_states": {"219": light},
        "map_features": {
            "219": {"type": "LANE_SURFACE_STREET", "polyline": lane, "entry_lanes": []},
            "220": {"type": "ROAD_EDGE_BOUNDARY", "polyline": lane + np.array([0.0, 3.0, 0.0])},
        },
        "metadata": {
            "ts": np.linspace(0, 1, STEPS, dtype=np.float32),
            "metadrive_processed": False,
            "coordinate": "waymo",
            "sdc_id": "7",
            "number_summary": {"object_types": {"VEHICLE", "TRAFFIC_CONE"}},
        },
        **changes,
    }


def write(path, protocol: int = 4, **changes):
    path.write_bytes(pickle.dumps(make_scenario(**changes), protocol))
    return path
