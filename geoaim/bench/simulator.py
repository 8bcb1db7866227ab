"""The simulator's stages: a step, collisions and off-road of 64 scenes of 20 agents, one thread.

    python -m geoaim.bench.simulator --json docs/bench/simulator.json

Each is set beside `agents * 4` sines, a yardstick of the machine, and beside shapely for overlaps.
With torchdrivesim installed its collisions and off-road distance are timed in the same run.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import shapely
import torch
import typer

from geoaim.bench.report import format_table, time_medians, write_rows
from geoaim.hdmap.drivable import find_drivable_area, sample_borders
from geoaim.hdmap.lanelet2 import HDMap, read_hdmap
from geoaim.simulation.infractions import compute_offroad_distance
from geoaim.simulation.overlap import box_iou, compute_box_corners
from geoaim.simulation.road_rules import make_drivable
from geoaim.simulation.simulator import Scenario, step

SCENES, AGENTS, SIDE = 64, 20, 80.0  # m of the square in which agents are
STATIONS = 12  # points of each side of a lane, in triangles


def traffic() -> Scenario:
    """Two steps of agents at random, as far apart as in traffic."""
    random = torch.rand(SCENES, AGENTS, 4, generator=torch.Generator().manual_seed(0))
    states = random * torch.tensor([SIDE, SIDE, 6.28, 10.0]) - torch.tensor([60.0, 0, 0, 0])
    sizes = torch.tensor([4.5, 1.9]).expand(SCENES, AGENTS, 2)
    there = torch.ones(SCENES, 2, AGENTS, dtype=torch.bool)
    feet = torch.arange(AGENTS).expand(SCENES, AGENTS) % 4 == 0
    return Scenario(torch.stack([states, states], 1), there, sizes, feet, 0.1)


def by_shapely(scenario: Scenario) -> np.ndarray:
    """Intersection over union of all pairs of the first scene."""
    corners = compute_box_corners(scenario.states[0, 0, :, :3], scenario.sizes[0]).double().numpy()
    polygons = shapely.polygons(corners)
    shared = shapely.area(shapely.intersection(polygons[:, None], polygons))
    area = shapely.area(polygons)
    return np.asarray(shared / (area[:, None] + area - shared) * (1 - np.eye(AGENTS)))


def timings(repeats: int) -> list[dict[str, Any]]:
    """Milliseconds of each stage."""
    scenario = traffic()
    states, there = scenario.states[:, 0], scenario.present[:, 0]
    actions, everyone = torch.full((SCENES, AGENTS, 2), 0.1), there
    hdmap = read_hdmap("samples/map.osm")
    drivable = make_drivable(find_drivable_area(hdmap))
    few = slice(0, 4)
    parts: dict[str, Callable[[], Any]] = {
        "sines, 4 an agent": lambda: torch.sin(states),
        "step": lambda: step(scenario, 0, states, actions, everyone),
        "compute_collision_iou, exact IoU of all pairs": lambda: box_iou(
            states[..., :3], scenario.sizes, there
        ),
        "off-road distance": lambda: compute_offroad_distance(
            drivable, states[..., :3], scenario.sizes, there
        ),
        "off-road distance, 4 scenes": lambda: compute_offroad_distance(
            drivable, states[few, :, :3], scenario.sizes[few], there[few]
        ),
        **_peers(scenario, hdmap),
    }
    with torch.no_grad():
        seconds = time_medians(list(parts.values()), repeats)
    return [{"stage": name, "ms": 1e3 * time} for name, time in zip(parts, seconds, strict=True)]


def _peers(scenario: Scenario, hdmap: HDMap) -> dict[str, Callable[[], Any]]:
    """What torchdrivesim takes for the same, where it is installed."""
    try:
        from torchdrivesim.infractions import iou_differentiable, offroad_infraction_loss
        from torchdrivesim.mesh import BaseMesh, BirdviewMesh
    except ImportError:
        return {}
    states, sizes = scenario.states[:, 0], scenario.sizes
    boxes = torch.cat([states[..., :2], sizes, states[..., 2:3]], dim=-1)
    row, column = torch.triu_indices(AGENTS, AGENTS, offset=1)
    corners, faces = _triangles(hdmap)
    mesh = BirdviewMesh.set_properties(BaseMesh(verts=corners, faces=faces), "road").expand(4)
    return {
        "torchdrivesim: iou_differentiable": lambda: iou_differentiable(
            boxes[:, row].flatten(0, 1)[:, None], boxes[:, column].flatten(0, 1)[:, None]
        ),
        "torchdrivesim: off-road, 4 scenes": lambda: offroad_infraction_loss(
            states[:4], sizes[:4], mesh
        ),
    }


def _triangles(hdmap: HDMap) -> tuple[torch.Tensor, torch.Tensor]:
    """The map's lanes as triangles, which torchdrivesim takes."""
    two = 2 * np.arange(STATIONS - 1)[:, None] + np.array([[0, 1, 2], [1, 2, 3]])[:, None]
    corners: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    for lanelet in hdmap.lanelets:
        sides = sample_borders(lanelet, np.linspace(0, 1, STATIONS))
        start = 2 * STATIONS * len(corners)
        corners.append(sides.swapaxes(0, 1).reshape(-1, 2))
        faces.append(start + two.reshape(-1, 3))
    return (
        torch.tensor(np.concatenate(corners), dtype=torch.float32)[None],
        torch.tensor(np.concatenate(faces))[None],
    )


def main(
    json: Annotated[Path | None, typer.Option(help="where to write the figures")] = None,
    repeats: Annotated[int, typer.Option(help="of each timing; the median counts")] = 30,
) -> None:
    """Time the stages and compare overlaps with shapely's; print tables, write JSON when asked."""
    torch.set_num_threads(1)
    scenario = traffic()
    close = Scenario(
        scenario.states / 8, scenario.present, scenario.sizes, scenario.pedestrian, 0.1
    )
    found = box_iou(close.states[:, 0, :, :3], close.sizes, close.present[:, 0])[0]
    apart = float(np.abs(found.numpy() - by_shapely(close)).max())
    rows = timings(repeats)
    print(format_table(rows), f"IoU against shapely: {apart:.1e} at most", sep="\n\n")
    command = f"python -m geoaim.bench.simulator --repeats {repeats}"
    write_rows(rows, json, command=command, torch=torch.__version__, iou_against_shapely=apart)


if __name__ == "__main__":
    typer.run(main)
