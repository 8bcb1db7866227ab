"""Futures on the map, for people: a picture, a film, a table."""

import math
import os
from collections.abc import Iterator

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from torch import Tensor

from geoaim.files import atomic_write
from geoaim.simulation.birdview import Boxes, render
from geoaim.simulation.ground import Ground, View, bounds_of, fit_ground
from geoaim.simulation.layers import lights_at, usual_colours
from geoaim.simulation.lines import path_boxes
from geoaim.simulation.pictures import pixels_of
from geoaim.simulation.scene import Scene
from geoaim.track_files import format_world
from geoaim.world import World

WIDE = 1280  # px of a picture's longer side
FUTURE = (1.0, 0.45, 0.0)
TRUTH = (0.95, 0.95, 0.95)
LINE = 0.5  # m that a path is wide
AROUND = 15.0  # m around all paths that a picture shows

Seen = tuple[View, Float[Tensor, "1 3"]]


def draw_futures(
    scene: Scene, futures: Float[Tensor, "K N T 4"], start: int, seen: Seen | None = None
) -> UInt8[Array, "H W 3"]:
    """The map, north up, with all futures, what really happened, and everybody at the start.

    Args:
        scene: map, agents and lights.
        futures: from `predict`.
        start: the step after which they begin.
        seen: view and camera; if left out, `all_futures`.
    """
    view, camera = seen or all_futures(scene, futures, start)
    after = scene.poses[None, :, start : start + 1 + futures.shape[2], :2]
    now = scene.poses[None, :, start : start + 1, :2].expand(len(futures), -1, -1, -1)
    moved = _moved(futures)
    ways = torch.cat([now, moved], dim=2)
    predicted = torch.isfinite(moved).flatten(2).any(dim=2).any(dim=0)
    after = torch.where(predicted[:, None, None], after, torch.nan)
    layers = [
        _paths(after, TRUTH, LINE),
        _paths(ways.flatten(0, 1)[None], FUTURE, LINE / 2),
        lights_at(scene, torch.tensor([start])),
        _agents(scene, scene.poses[:, start]),
    ]
    return _picture(view, camera, fit_ground(scene.ground, view.resolution), layers)


def all_futures(scene: Scene, futures: Float[Tensor, "K N T 4"], start: int) -> Seen:
    """A view of all futures, as far as the map goes, north up."""
    places = torch.cat([futures[..., :2].flatten(0, 2), scene.poses[:, start, :2]])
    places = places[torch.isfinite(places).all(dim=1)]
    first, last = bounds_of(scene.ground).to(places)
    low = (places.amin(dim=0) - AROUND).clamp(first, last - AROUND)
    high = (places.amax(dim=0) + AROUND).clamp(low + AROUND, last)
    width, height = (high - low).tolist()
    metres = max(width, height) / WIDE
    rows, columns = (2 * max(1, round(side / metres / 2)) for side in (height, width))
    middle = (low + high) / 2
    camera = torch.cat([middle, middle.new_tensor([math.pi / 2])])[None]
    return View(rows, columns, metres), camera


def film_futures(
    scene: Scene, futures: Float[Tensor, "K N T 4"], start: int
) -> Iterator[UInt8[Array, "H W 3"]]:
    """The futures as they go on, all of them in one picture a step."""
    view, camera = all_futures(scene, futures, start)
    ground, moved = fit_ground(scene.ground, view.resolution), _moved(futures)
    for number in range(futures.shape[2]):
        ways = moved[:, :, : number + 1].flatten(0, 1)[None]
        layers = [] if number == 0 else [_paths(ways, FUTURE, LINE / 2)]
        layers += [_agents(scene, future[:, number, :3]) for future in futures]
        yield _picture(view, camera, ground, layers)


def write_futures(
    scene: Scene,
    futures: Float[Tensor, "K N T 4"],
    start: int,
    path: str | os.PathLike[str],
    *,
    world: World,
    seconds: float,
) -> None:
    """A table with a row for each sample, agent and step, below the lines of `geoaim.tracks`.

    Columns are sample, id, type, time, x, y, heading, speed, in the units of tracks; steps last
    so many seconds.
    """
    sample, agent, step = torch.isfinite(futures[..., 0]).nonzero().unbind(1)
    values = futures[sample, agent, step].double().cpu().numpy()
    table = pd.DataFrame(
        {
            "sample": sample.cpu().numpy(),
            "id": np.array(scene.ids, object)[agent.cpu().numpy()],
            "type": np.array(scene.types, object)[agent.cpu().numpy()],
            "time": (float(scene.times[start]) + (step.cpu().numpy() + 1) * seconds).round(3),
        }
    )
    for column, name in enumerate(("x", "y", "heading", "speed")):
        table[name] = values[:, column].round(4)
    with atomic_write(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        file.write(format_world(world))
        table.to_csv(file, index=False)


def _moved(futures: Float[Tensor, "K N T 4"]) -> Float[Tensor, "K N T 2"]:
    """Places of those whose samples differ; NaN of those who replay, the same in all of them."""
    places = futures[..., :2]
    if len(futures) == 1:
        return places
    same = ((places - places[:1]).nan_to_num() == 0).flatten(2).all(dim=2).all(dim=0)
    return torch.where(same[:, None, None], torch.nan, places)


def _paths(
    points: Float[Tensor, "1 P S 2"], colour: tuple[float, float, float], width: float
) -> Boxes:
    present = torch.isfinite(points).all(dim=-1)
    safe = torch.where(present[..., None], points, 0.0)
    colours = points.new_tensor([colour]).expand(points.shape[1], 3)
    return path_boxes(safe, colours, width=width, present=present)


def _agents(scene: Scene, poses: Float[Tensor, "N 3"]) -> Boxes:
    present = torch.isfinite(poses).all(dim=1)
    colours = usual_colours(scene)
    noses = torch.ones_like(colours)
    safe = torch.where(present[:, None], poses, 0.0)
    return Boxes(safe[None], scene.sizes, colours, present[None], noses)


def _picture(
    view: View, camera: Float[Tensor, "1 3"], ground: Ground, layers: list[Boxes]
) -> UInt8[Array, "H W 3"]:
    with torch.no_grad():
        return pixels_of(render(view, camera, ground, layers))[0]
