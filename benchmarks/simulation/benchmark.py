"""Stages of the simulator: a step, drivers, collisions and off-road distances, on one thread.

    python -m benchmarks.simulation --json docs/bench/simulator.json

64 scenes of 20 agents are timed beside four sines for each agent, a yardstick of the machine; times
are processor times. Drivers find the conflicts of their routes once, before the first step.
Where torchdrivesim is installed, its collisions and off-road distances are timed in the same run.
"""

import time
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
import torch
import typer

from benchmarks.results import JsonFile, print_rows, time_medians, write_rows
from geoaim.hdmap.drivable import find_drivable_area, sample_borders
from geoaim.hdmap.lanelet2 import HDMap, read_hdmap
from geoaim.simulation.idm import make_idm_policy
from geoaim.simulation.infractions import compute_offroad_distance
from geoaim.simulation.overlap import box_iou
from geoaim.simulation.road_rules import make_drivable
from geoaim.simulation.routes import Routes, resample_points
from geoaim.simulation.simulator import Policy, Scenario, step

SCENES, AGENTS, SIDE_M = 64, 20, 80.0
ROUTE_M, DESIRED_SPEED_MPS = 100.0, 10.0
BORDER_POINTS = 12  # points of each border of a lane, in triangles


def _make_traffic() -> Scenario:
    """Make two steps of random agents, as far apart as in traffic."""
    random = torch.rand(SCENES, AGENTS, 4, generator=torch.Generator().manual_seed(0))
    states = random * torch.tensor([SIDE_M, SIDE_M, 6.28, 10.0]) - torch.tensor([60.0, 0, 0, 0])
    sizes = torch.tensor([4.5, 1.9]).expand(SCENES, AGENTS, 2)
    present = torch.ones(SCENES, AGENTS, 2, dtype=torch.bool)
    pedestrian = torch.arange(AGENTS).expand(SCENES, AGENTS) % 4 == 0
    return Scenario(torch.stack([states, states], 2), present, sizes, pedestrian, 0.1)


def _make_drivers(scenario: Scenario) -> Policy:
    """Make drivers of all agents, straight on."""
    x, y, heading, _ = scenario.states[:, :, 0].unbind(-1)
    start = torch.stack([x, y], dim=-1)
    way = ROUTE_M * torch.stack([heading.cos(), heading.sin()], dim=-1)
    points = resample_points(torch.stack([start, start + way], dim=2))
    length = torch.full_like(x, ROUTE_M)
    routes = Routes(points, length, torch.zeros_like(scenario.pedestrian))
    everyone = torch.ones_like(scenario.pedestrian)
    desired_speeds = torch.full_like(x, DESIRED_SPEED_MPS)
    return make_idm_policy(routes, desired_speeds, scenario.sizes, everyone)


def _time_stages(repeats: int) -> list[dict[str, Any]]:
    scenario = _make_traffic()
    states, present, sizes = scenario.states[:, :, 0], scenario.present[:, :, 0], scenario.sizes
    poses, actions = states[..., :3], torch.full((SCENES, AGENTS, 2), 0.1)
    hdmap = read_hdmap("samples/map.osm")
    drivable = make_drivable(find_drivable_area(hdmap))
    drivers = _make_drivers(scenario)
    driving: dict[str, Callable[[], Any]] = {
        "sines, 4 per agent": lambda: torch.sin(states),
        "step": lambda: step(scenario, 0, states, actions, present),
        "actions of intelligent drivers": lambda: drivers(scenario, scenario.states[:, :, :1]),
    }
    counting: dict[str, Callable[[], Any]] = {
        "collisions, exact IoU of all pairs": lambda: box_iou(poses, sizes, present),
        "off-road distance": lambda: compute_offroad_distance(drivable, poses, sizes, present),
        "off-road distance, 4 scenes": lambda: compute_offroad_distance(
            drivable, poses[:4], sizes[:4], present[:4]
        ),
        **_list_torchdrivesim(scenario, hdmap),
    }
    once = {"conflicts of the drivers' routes, once": lambda: _make_drivers(scenario)}
    rows = []
    with torch.no_grad():  # the stages of a group in turn
        for group, count in ((driving, repeats), (counting, repeats), (once, 1)):
            durations = time_medians(list(group.values()), count, time.process_time)
            rows += [
                {"stage": name, "ms": 1e3 * duration}
                for name, duration in zip(group, durations, strict=True)
            ]
    return rows


def _list_torchdrivesim(scenario: Scenario, hdmap: HDMap) -> dict[str, Callable[[], Any]]:
    """List the same stages of torchdrivesim, where it is installed."""
    try:
        from torchdrivesim.infractions import iou_differentiable, offroad_infraction_loss
        from torchdrivesim.mesh import BaseMesh, BirdviewMesh
    except ImportError:
        return {}
    states, sizes = scenario.states[:, :, 0], scenario.sizes
    boxes = torch.cat([states[..., :2], sizes, states[..., 2:3]], dim=-1)
    row, column = torch.triu_indices(AGENTS, AGENTS, offset=1)
    corners, faces = _triangulate_lanes(hdmap)
    mesh = BirdviewMesh.set_properties(BaseMesh(verts=corners, faces=faces), "road").expand(4)
    return {
        "torchdrivesim: iou_differentiable": lambda: iou_differentiable(
            boxes[:, row].flatten(0, 1)[:, None], boxes[:, column].flatten(0, 1)[:, None]
        ),
        "torchdrivesim: off-road, 4 scenes": lambda: offroad_infraction_loss(
            states[:4], sizes[:4], mesh
        ),
    }


def _triangulate_lanes(hdmap: HDMap) -> tuple[torch.Tensor, torch.Tensor]:
    """Triangulate the lanes of a map, for torchdrivesim: corners (1, V, 2), faces (1, F, 3)."""
    pair = 2 * np.arange(BORDER_POINTS - 1)[:, None] + np.array([[0, 1, 2], [1, 2, 3]])[:, None]
    corners: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    for lanelet in hdmap.lanelets:
        sides = sample_borders(lanelet, np.linspace(0, 1, BORDER_POINTS))
        start = 2 * BORDER_POINTS * len(corners)
        corners.append(sides.swapaxes(0, 1).reshape(-1, 2))
        faces.append(start + pair.reshape(-1, 3))
    return (
        torch.tensor(np.concatenate(corners), dtype=torch.float32)[None],
        torch.tensor(np.concatenate(faces))[None],
    )


def main(
    json: JsonFile = None,
    repeats: Annotated[int, typer.Option(help="of each timing; the median counts")] = 30,
) -> None:
    """Time the stages; print a table and write JSON."""
    torch.set_num_threads(1)
    rows = print_rows(_time_stages(repeats))
    command = f"python -m benchmarks.simulation --repeats {repeats}"
    write_rows(rows, json, command=command, torch=torch.__version__)
