"""ScenarioNet's map features, made of an HD map."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import LineString

from geoaim.base.world import World, change_world
from geoaim.hdmap.drivable import sample_borders
from geoaim.hdmap.lanelet2 import HDMap, Lanelet

LANES = {"bicycle_lane": "LANE_BIKE_LANE", "bikelane": "LANE_BIKE_LANE"}
AREAS = {"crosswalk": "CROSSWALK", "walkway": "ROAD_EDGE_SIDEWALK"}
EDGES = ("curbstone", "road_border", "guard_rail")
MARKINGS = ("line_thin", "line_thick")
SPACING_M = 2.0  # distance between the points along the middle of a lane
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
        if line.kind in MARKINGS:
            style = "BROKEN" if line.subtype == "dashed" else "SOLID"
            kind = f"ROAD_LINE_{style}_SINGLE_WHITE"
        if kind is not None and len(line.points) > 1:
            features[f"line-{number}"] = {"type": kind, "polyline": move(line.points)}
    return features


def _sample_middle(lanelet: Lanelet) -> Float[Array, "n 2"]:
    length = max(LineString(line).length for line in (lanelet.left, lanelet.right))
    shares = np.linspace(0, 1, max(2, int(np.ceil(length / SPACING_M)) + 1))
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
