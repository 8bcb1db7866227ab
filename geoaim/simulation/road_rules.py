"""Road rules as tensors: where vehicles may drive, and in which direction."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Int
from shapely import MultiPolygon
from torch import Tensor

from geoaim.base.errors import MapError
from geoaim.base.world import World, describe_world
from geoaim.hdmap.drivable import find_drivable_area, sample_lane_directions
from geoaim.hdmap.lanelet2 import HDMap
from geoaim.rendering.atlas import pack_rectangles
from geoaim.rendering.ground import find_offset, move_transform, world_from_pixels
from geoaim.rendering.scene import Scene, check_near_origin, check_touches_map
from geoaim.simulation.infractions import Drivable, Lanes


@dataclass(frozen=True, eq=False)
class RoadRules:
    """Drivable area and one-way lanes, by which infractions are found; None where unknown.

    Attributes:
        drivable: distances from the drivable area.
        lanes: directions of one-way lanes.
        world: the plane of the metres; None: not known, or there are several.
    """

    drivable: Drivable | None = None
    lanes: Lanes | None = None
    world: World | None = None

    def select(self, places: Int[Tensor, "B"]) -> "RoadRules":
        """Choose, from rules of several places (`stack_rules`), the place of each of B scenes."""
        drivable, lanes = self.drivable, self.lanes
        if drivable is not None and drivable.regions is not None:
            drivable = replace(
                drivable,
                grid_from_world=drivable.grid_from_world[places],
                regions=drivable.regions[places],
            )
        if lanes is not None:
            lanes = Lanes(lanes.points[places], lanes.directions[places], lanes.radii[places])
        return RoadRules(drivable, lanes, self.world)


NO_ROAD_RULES = RoadRules()


def make_road_rules(
    hdmap: HDMap | None, area: MultiPolygon | None = None, *, world: World | None = None
) -> RoadRules:
    """Make road rules of an HD map's lanes, and of a drivable area.

    Args:
        hdmap: the lanes; None: there are none.
        area: the drivable area, in the HD map's world if there is one; None: the HD map's own area.
        world: the plane of an area without an HD map.

    Returns:
        The rules.

    Raises:
        MapError: the map or the area lies too far from the world's origin, or the map has no lane
            for vehicles.
    """
    if area is None and hdmap is not None:
        area = find_drivable_area(hdmap)
    drivable = None if area is None else make_drivable(area)
    if hdmap is None:
        return RoadRules(drivable, None, world)
    return RoadRules(drivable, make_lanes(hdmap), hdmap.world)


def move_rules(rules: RoadRules, world: World | None) -> RoadRules:
    """Move rules to a world of the same CRS; those whose world is not known stay where they are.

    Raises:
        MapError: the move would not be exact.
    """
    offset = find_offset(rules.world, world, "road rules")
    if offset == (0.0, 0.0):
        return rules
    drivable, lanes = rules.drivable, rules.lanes
    if drivable is not None:
        matrix = move_transform(drivable.grid_from_world, offset)
        drivable = replace(drivable, grid_from_world=matrix)
    if lanes is not None:
        lanes = replace(lanes, points=lanes.points + lanes.points.new_tensor(offset))
    return RoadRules(drivable, lanes, world)


def move_rules_to_any(rules: RoadRules, worlds: Sequence[World]) -> RoadRules:
    """Move rules to the only world of some data.

    Raises:
        MapError: the move would not be exact, or the data lie in several worlds.
    """
    if rules.world is None or not worlds:
        return rules
    if len(worlds) > 1:
        raise MapError(
            f"the segments lie in {len(worlds)} worlds and the road rules in "
            f"{describe_world(rules.world)}; evaluate the segments of one place at a time"
        )
    return move_rules(rules, worlds[0])


def stack_rules(rules: Sequence[RoadRules]) -> RoadRules:
    """Put the rules of several places together; `RoadRules.select` then chooses among them.

    Rasters are copied into one; lanes are padded with points that no agent reaches.

    Raises:
        ValueError: there are none, or only some have a drivable area or lanes.
    """
    drivables = [rule.drivable for rule in rules if rule.drivable is not None]
    lanes = [rule.lanes for rule in rules if rule.lanes is not None]
    if not rules or {len(drivables), len(lanes)} - {0, len(rules)}:
        raise ValueError(
            f"of {len(rules)} places {len(drivables)} have a drivable area and {len(lanes)} lanes; "
            "give each of them for all places or for none"
        )
    return RoadRules(
        _stack_drivables(drivables) if drivables else None,
        _stack_lanes(lanes) if lanes else None,
        rules[0].world if all(rule.world == rules[0].world for rule in rules) else None,
    )


def _stack_drivables(drivables: Sequence[Drivable]) -> Drivable:
    shapes = [(int(d.distance.shape[0]), int(d.distance.shape[1])) for d in drivables]
    places, size = pack_rectangles(shapes)
    distance = drivables[0].distance.new_zeros(size)
    matrices, regions = [], []
    for drivable, (top, left), (height, width) in zip(drivables, places, shapes, strict=True):
        distance[top : top + height, left : left + width] = drivable.distance
        offset = drivable.grid_from_world.new_tensor([[left], [top]])
        matrices.append(drivable.grid_from_world + F.pad(offset, (2, 0)))
        regions.append([left, top, left + width, top + height])
    edges = torch.tensor(regions, device=distance.device)
    return Drivable(distance, torch.stack(matrices), edges)


def _stack_lanes(lanes: Sequence[Lanes]) -> Lanes:
    most = max(len(lane.directions) for lane in lanes)
    padded = [
        (
            F.pad(lane.points, (0, 0, 0, most - len(lane.points))),
            F.pad(lane.directions, (0, most - len(lane.directions))),
            F.pad(lane.radii, (0, most - len(lane.radii))),  # 0: no agent is as near
        )
        for lane in lanes
    ]
    return Lanes(*(torch.stack(parts) for parts in zip(*padded, strict=True)))


def make_drivable(area: MultiPolygon, *, resolution: float = 0.2) -> Drivable:
    """Rasterize the signed distance from the edge of an area, at `resolution` metres per pixel.

    Raises:
        MapError: the area is empty or too narrow, or lies too far from the world's origin.
    """
    from geoaim.hdmap.drivable import compute_signed_distance  # needs OpenCV and rasterio

    check_near_origin("drivable area", np.array(area.bounds).reshape(2, 2))
    distance, grid = compute_signed_distance(area, resolution=resolution)
    grid_from_world = torch.tensor(grid.grid_from_world[:2], dtype=torch.float32)
    return Drivable(torch.tensor(distance), grid_from_world)


def make_lanes(hdmap: HDMap) -> Lanes:
    """Sample the directions of a map's one-way lanes along their centre lines."""
    arrays = sample_lane_directions(hdmap)
    check_near_origin("HD map", arrays[0])
    return Lanes(*(torch.tensor(array, dtype=torch.float32) for array in arrays))


def check_rules(scene: Scene, rules: RoadRules) -> RoadRules:
    """Check that road rules are for the place of the scene's map.

    Returns:
        The rules in the scene's world.

    Raises:
        TracksError: no lane, or no part of the drivable area, lies on the map.
        MapError: the rules are of a world from which moving is not exact.
    """
    rules = move_rules(rules, scene.world)
    bounds = scene.ground.bounds[0].cpu().numpy()
    if rules.lanes is not None and len(rules.lanes.points):
        check_touches_map("lane", rules.lanes.points.double().cpu().numpy(), bounds)
    if rules.drivable is not None:
        pixels = (rules.drivable.distance < 0).nonzero().flip(1) + 0.5
        points = world_from_pixels(rules.drivable.grid_from_world, pixels).cpu().numpy()
        check_touches_map("drivable area", points, bounds)
    return rules
