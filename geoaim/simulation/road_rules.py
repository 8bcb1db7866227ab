"""Road rules as tensors: where vehicles may drive, and in which direction."""

from dataclasses import dataclass

import numpy as np
import torch
from shapely import MultiPolygon

from geoaim.hdmap.drivable import find_drivable_area, sample_lane_directions
from geoaim.hdmap.lanelet2 import HDMap
from geoaim.hdmap.signed_distance import compute_signed_distance
from geoaim.simulation.ground import world_from_pixels
from geoaim.simulation.infractions import Drivable, Lanes
from geoaim.simulation.scene import Scene, check_near_origin, check_touches_map


@dataclass(frozen=True, eq=False)
class RoadRules:
    """Drivable area and one-way lanes, by which infractions are found; None where unknown."""

    drivable: Drivable | None = None  # distances from the drivable area
    lanes: Lanes | None = None  # directions of one-way lanes


NO_ROAD_RULES = RoadRules()


def make_road_rules(hdmap: HDMap | None, area: MultiPolygon | None = None) -> RoadRules:
    """Make road rules of an HD map's lanes, and of a drivable area; None: that of the HD map.

    Raises:
        MapError: the map or the area lies too far from the world's origin, or the map has no lane
            for vehicles.
    """
    if area is None and hdmap is not None:
        area = find_drivable_area(hdmap)
    drivable = None if area is None else make_drivable(area)
    return RoadRules(drivable, None if hdmap is None else make_lanes(hdmap))


def make_drivable(area: MultiPolygon, *, resolution: float = 0.2) -> Drivable:
    """Rasterize the signed distance from the edge of an area, at `resolution` metres per pixel.

    Raises:
        MapError: the area is empty or too narrow, or lies too far from the world's origin.
    """
    check_near_origin("drivable area", np.array(area.bounds).reshape(2, 2))
    distance, grid = compute_signed_distance(area, resolution=resolution)
    grid_from_world = torch.tensor(grid.grid_from_world[:2], dtype=torch.float32)
    return Drivable(torch.tensor(distance), grid_from_world)


def make_lanes(hdmap: HDMap) -> Lanes:
    """Sample the directions of a map's one-way lanes along their centre lines.

    Raises:
        MapError: the lanes lie too far from the world's origin.
    """
    arrays = sample_lane_directions(hdmap)
    check_near_origin("HD map", arrays[0])
    return Lanes(*(torch.tensor(array, dtype=torch.float32) for array in arrays))


def check_rules(scene: Scene, rules: RoadRules) -> None:
    """Check that rules are not of another place than the scene's map.

    Raises:
        TracksError: no lane, or no part of the drivable area, lies on the map.
    """
    bounds = scene.ground.bounds.cpu().numpy()
    if rules.lanes is not None and len(rules.lanes.points):
        check_touches_map("lane", rules.lanes.points.double().cpu().numpy(), bounds)
    if rules.drivable is not None:
        pixels = (rules.drivable.distance < 0).nonzero().flip(1) + 0.5
        points = world_from_pixels(rules.drivable.grid_from_world, pixels).cpu().numpy()
        check_touches_map("drivable area", points, bounds)
