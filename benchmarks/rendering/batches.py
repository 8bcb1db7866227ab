"""How the renderer's time grows with maps in a batch, threads, and boxes on one spot."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from benchmarks.rendering.peers import make_sampling_grid
from benchmarks.results import time_medians
from geoaim.rendering import (
    Ground,
    OrientedBoxes,
    View,
    make_ground,
    prefilter_ground,
    render,
    stack_grounds,
)

VIEW_SIDE_M, AGENTS, VIEWS = 100.0, 20, 64
CAR_SIZE_M = (4.5, 1.9)
BOX_PX = 80  # side of the boxes that lie on one spot
Scene = tuple[View, Float[Tensor, "B 3"], OrientedBoxes]


def make_scene(pixels: int, views: int, agents: int = AGENTS, *, seed: int = 1) -> Scene:
    """Make random views of 100 m a side, and cars with triangles around each.

    Args:
        pixels: side of a view.
        views: number of cameras.
        agents: boxes in each view.
        seed: seed of the places.

    Returns:
        The view, (B, 3) cameras and (B, A) boxes.
    """
    generator = torch.Generator().manual_seed(seed)
    random = torch.rand(views, agents + 1, 6, generator=generator, dtype=torch.float64).float()
    cameras = torch.cat([random[:, 0, :2] * 60 - 30, random[:, 0, 2:3] * 6.28], 1)
    positions = cameras[:, None, :2] + (random[:, 1:, :2] - 0.5) * 0.8 * VIEW_SIDE_M
    poses = torch.cat([positions, random[:, 1:, 2:3] * 6.28], 2)
    colours = random[:, 1:, 3:]
    sizes = torch.tensor([CAR_SIZE_M]).expand(agents, 2)
    boxes = OrientedBoxes(poses, sizes, colours, heading_colours=1 - colours)
    return View(pixels, pixels, VIEW_SIDE_M / pixels), cameras, boxes


def time_maps(pixels: int, repeats: int, side: int = 1024) -> dict[str, Any]:
    """Time views of as many maps beside views of one map, processor time, one thread.

    Args:
        pixels: side of a view.
        repeats: repetitions of each timing; the median counts.
        side: side of a map, pixels.

    Returns:
        A row of the table.
    """
    view, cameras, boxes = make_scene(pixels, VIEWS)
    scale, middle = side / (2 * VIEW_SIDE_M), side / 2
    matrix = torch.tensor([[scale, 0, middle], [0, -scale, middle]])
    textures = [torch.rand(3, side, side) for _ in range(VIEWS)]
    grounds = [prefilter_ground(make_ground(t, matrix), view.resolution) for t in textures]
    stacked = stack_grounds(grounds).select(torch.arange(VIEWS))
    # what memory alone costs: the same views by `grid_sample`, of one texture and of all
    batch = torch.stack([ground.image for ground in grounds])
    grid = _make_grids(view, cameras, grounds[0])
    parts = [_draw(view, cameras, ground, boxes) for ground in (grounds[0], stacked)]
    parts += [_sample(batch[:1].expand_as(batch), grid), _sample(batch, grid)]
    one, many, one_alone, many_alone = time_medians(parts, repeats, time.process_time)
    return {
        "pixels": pixels,
        "views": VIEWS,
        "maps": VIEWS,
        "ratio to one map": many / one,
        "grid_sample, ratio to one map": many_alone / one_alone,
        "ratio to grid_sample on as many maps": many / many_alone,
    }


def time_threads(ground: Ground, pixels: int, repeats: int) -> dict[str, Any]:
    """Time one thread beside two, wall time: free cores are needed.

    Args:
        ground: the map.
        pixels: side of a view.
        repeats: repetitions of each timing; the median counts.

    Returns:
        A row of the table.
    """
    view, cameras, boxes = make_scene(pixels, VIEWS)
    ground = prefilter_ground(ground, view.resolution)
    poses = boxes.poses.clone().requires_grad_()
    weight = torch.rand(VIEWS, 3, pixels, pixels)

    def draw_and_differentiate() -> None:
        picture = render(view, cameras, ground, [replace(boxes, poses=poses)])
        torch.autograd.grad((picture * weight).sum(), poses)

    parts: list[Callable[[], Any]] = [_draw(view, cameras, ground, boxes), draw_and_differentiate]
    durations = [
        time_medians([_run_with_threads(part, n) for n in (1, 2)], repeats) for part in parts
    ]
    torch.set_num_threads(1)
    (one, two), (one_both, two_both) = durations
    return {
        "pixels": pixels,
        "views": VIEWS,
        "two threads, times as fast": one / two,
        "forward + backward, times as fast": one_both / two_both,
    }


def time_stack(ground: Ground, count: int, repeats: int) -> dict[str, Any]:
    """Time boxes of 80 px on one spot beside a single one, processor time, one thread.

    Args:
        ground: the map.
        count: number of boxes.
        repeats: repetitions of each timing; the median counts.

    Returns:
        A row of the table.
    """
    view, cameras, _ = make_scene(256, 1)
    ground = prefilter_ground(ground, view.resolution)
    random = torch.rand(1, count, 6, generator=torch.Generator().manual_seed(2))
    poses = cameras[:, None] + random[..., :3] * torch.tensor([1.0, 1.0, 0.3])
    size = torch.full((2,), BOX_PX * view.resolution)
    boxes = OrientedBoxes(poses, size, random[..., 3:])
    first = replace(boxes, poses=poses[:, :1], colours=boxes.colours[:, :1])
    poses_of = [layer.poses.clone().requires_grad_() for layer in (first, boxes)]

    def differentiate(layer: OrientedBoxes, leaf: Tensor) -> Callable[[], Any]:
        def run() -> None:
            picture = render(view, cameras, ground, [replace(layer, poses=leaf)])
            torch.autograd.grad(picture.sum(), leaf)

        return run

    parts = [_draw(view, cameras, ground, layer) for layer in (first, boxes)]
    parts += [differentiate(*pair) for pair in zip((first, boxes), poses_of, strict=True)]
    one, many, one_both, many_both = time_medians(parts, repeats, time.process_time)
    return {
        "boxes on one spot": count,
        "ms": 1e3 * many,
        "ratio to one box": many / one,
        "forward + backward, ratio to one box": many_both / one_both,
    }


def _make_grids(view: View, cameras: Float[Tensor, "B 3"], ground: Ground) -> Tensor:
    """Make the (B, H, W, 2) positions of the pixels of all views in one texture."""
    grid = make_sampling_grid(view, cameras, ground)
    return grid.view(len(cameras), view.height, view.width, 2)


def _sample(textures: Float[Tensor, "B C h w"], grid: Tensor) -> Callable[[], Tensor]:
    return lambda: F.grid_sample(textures, grid, padding_mode="border", align_corners=False)


def _draw(
    view: View, cameras: Float[Tensor, "B 3"], ground: Ground, boxes: OrientedBoxes
) -> Callable[[], Tensor]:
    return torch.no_grad()(lambda: render(view, cameras, ground, [boxes]))


def _run_with_threads(function: Callable[[], Any], threads: int) -> Callable[[], None]:
    def run() -> None:
        torch.set_num_threads(threads)
        function()

    return run
