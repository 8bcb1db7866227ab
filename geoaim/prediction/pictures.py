"""Futures on the map as pictures and frames of a film, and as a table."""

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from torch import Tensor

from geoaim.files import atomic_write
from geoaim.simulation.birdview import OrientedBoxes, render
from geoaim.simulation.ground import Ground, View, prefilter_ground
from geoaim.simulation.layers import get_agent_colours, make_light_boxes
from geoaim.simulation.lines import make_path_boxes
from geoaim.simulation.pictures import convert_to_uint8
from geoaim.simulation.scene import Scene
from geoaim.track_files import format_world
from geoaim.world import World

PICTURE_SIZE_PX = 1280  # of the longer side
FUTURE_COLOUR = (1.0, 0.45, 0.0)
TRUTH_COLOUR = (0.95, 0.95, 0.95)
PATH_WIDTH_M = 0.5
MARGIN_M = 15.0  # of a picture around all paths


@dataclass(frozen=True, eq=False)
class Camera:
    """A view and where it is."""

    view: View  # size and resolution
    pose: Float[Tensor, "1 3"]  # x, y and heading of its centre


def draw_futures(
    scene: Scene, futures: Float[Tensor, "K N T 4"], start: int, camera: Camera | None = None
) -> UInt8[Array, "H W 3"]:
    """Draw the map, north up, with agents at the start, all futures, and the ground truth.

    Args:
        scene: map, agents and lights.
        futures: from `predict`.
        start: index of the last observed step.
        camera: what to show; None: `fit_camera`.

    Returns:
        An RGB picture; futures are orange, the ground truth is white.
    """
    camera = camera or fit_camera(scene, futures, start)
    paths = _select_predicted(futures)
    current = scene.poses[None, :, start : start + 1, :2].expand(len(futures), -1, -1, -1)
    predicted = torch.isfinite(paths).flatten(2).any(dim=2).any(dim=0)
    truth = scene.poses[None, :, start : start + 1 + futures.shape[2], :2]
    truth = torch.where(predicted[:, None, None], truth, torch.nan)
    layers = [
        _make_path_boxes(truth, TRUTH_COLOUR, PATH_WIDTH_M),
        _make_path_boxes(
            torch.cat([current, paths], dim=2).flatten(0, 1)[None], FUTURE_COLOUR, PATH_WIDTH_M / 2
        ),
        make_light_boxes(scene, torch.tensor([start])),
        _make_agent_boxes(scene, scene.poses[:, start]),
    ]
    return _draw(camera, prefilter_ground(scene.ground, camera.view.resolution), layers)


def fit_camera(scene: Scene, futures: Float[Tensor, "K N T 4"], start: int) -> Camera:
    """Fit a camera, north up, to all futures as far as the map reaches.

    Args:
        scene: map and agents.
        futures: (K, N, T, 4) x, y (metres), heading, speed of K samples, NaN where absent.
        start: index of the scene's last observed step.

    Returns:
        The camera, which also shows where the agents are at `start`.
    """
    positions = torch.cat([futures[..., :2].flatten(0, 2), scene.poses[:, start, :2]])
    positions = positions[torch.isfinite(positions).all(dim=1)]
    first, last = scene.ground.bounds.to(positions)
    low = (positions.amin(dim=0) - MARGIN_M).clamp(first, last - MARGIN_M)
    high = (positions.amax(dim=0) + MARGIN_M).clamp(low + MARGIN_M, last)
    width, height = (high - low).tolist()
    resolution = max(width, height) / PICTURE_SIZE_PX
    rows, columns = (2 * max(1, round(side / resolution / 2)) for side in (height, width))
    centre = (low + high) / 2
    pose = torch.cat([centre, centre.new_tensor([math.pi / 2])])[None]
    return Camera(View(rows, columns, resolution), pose)


def film_futures(
    scene: Scene, futures: Float[Tensor, "K N T 4"], start: int
) -> Iterator[UInt8[Array, "H W 3"]]:
    """Draw the futures step by step, all samples in one picture.

    Args:
        scene: map and agents.
        futures: from `predict`.
        start: index of the last observed step.

    Yields:
        An RGB picture for each predicted step.
    """
    camera = fit_camera(scene, futures, start)
    ground, paths = (
        prefilter_ground(scene.ground, camera.view.resolution),
        _select_predicted(futures),
    )
    for step in range(futures.shape[2]):
        layers = [_make_agent_boxes(scene, future[:, step, :3]) for future in futures]
        if step:
            until = paths[:, :, : step + 1].flatten(0, 1)[None]
            layers.insert(0, _make_path_boxes(until, FUTURE_COLOUR, PATH_WIDTH_M / 2))
        yield _draw(camera, ground, layers)


def write_futures(
    scene: Scene,
    futures: Float[Tensor, "K N T 4"],
    start: int,
    path: str | os.PathLike[str],
    *,
    world: World,
    dt: float,
) -> None:
    """Write a CSV with a row for each sample, agent and step, below the header of tracks.

    Columns are sample, id, type, time, x, y, heading, speed, in the units of tracks.

    Args:
        scene: names, types and times.
        futures: from `predict`.
        start: index of the last observed step.
        path: of the file.
        world: of the scene.
        dt: time between steps, s.
    """
    begin = float(scene.times[start])
    with atomic_write(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        file.write(format_world(world))
        for sample, future in enumerate(futures):  # a table of all takes much memory
            agent, step = torch.isfinite(future[..., 0]).nonzero().cpu().numpy().T
            values = future.double().cpu().numpy()[agent, step].round(4)
            table = pd.DataFrame(values, columns=["x", "y", "heading", "speed"])
            table.insert(0, "time", (begin + (step + 1) * dt).round(3))
            table.insert(0, "type", np.array(scene.types, object)[agent])
            table.insert(0, "id", np.array(scene.ids, object)[agent])
            table.insert(0, "sample", sample)
            table.to_csv(file, index=False, header=sample == 0)


def _select_predicted(futures: Float[Tensor, "K N T 4"]) -> Float[Tensor, "K N T 2"]:
    """Positions of agents whose samples differ; NaN for the others, which replay."""
    positions = futures[..., :2]
    if len(futures) == 1:
        return positions
    same = ((positions - positions[:1]).nan_to_num() == 0).flatten(2).all(dim=2).all(dim=0)
    return torch.where(same[:, None, None], torch.nan, positions)


def _make_path_boxes(
    points: Float[Tensor, "1 P S 2"], colour: tuple[float, float, float], width: float
) -> OrientedBoxes:
    present = torch.isfinite(points).all(dim=-1)
    safe = torch.where(present[..., None], points, 0.0)
    colours = points.new_tensor([colour]).expand(points.shape[1], 3)
    return make_path_boxes(safe, colours, width=width, present=present)


def _make_agent_boxes(scene: Scene, poses: Float[Tensor, "N 3"]) -> OrientedBoxes:
    present = torch.isfinite(poses).all(dim=1)
    colours = get_agent_colours(scene)
    safe = torch.where(present[:, None], poses, 0.0)
    return OrientedBoxes(safe[None], scene.sizes, colours, present[None], torch.ones_like(colours))


@torch.no_grad()
def _draw(camera: Camera, ground: Ground, layers: list[OrientedBoxes]) -> UInt8[Array, "H W 3"]:
    return convert_to_uint8(render(camera.view, camera.pose, ground, layers))[0]
