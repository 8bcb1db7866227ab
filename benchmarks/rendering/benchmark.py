"""The bird's-eye renderer against `grid_sample` alone, OpenCV, plain torch, and a reference.

    python -m benchmarks.rendering --json docs/bench/birdview.json \\
        --chart docs/images/birdview.png

Speed: 20 agents, views of 100 m, a texture of 1024 x 1024 px over 200 m, one thread. The parts of a
row are timed in turn, in processor time, which other work on the machine disturbs less than wall
time, and medians compared. Accuracy: a pixel of the reference is the mean of 377 points.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from time import process_time
from typing import Annotated, Any

import cv2
import torch
import torch.nn.functional as F
import typer
from jaxtyping import Float
from matplotlib.figure import Figure
from torch import Tensor

from benchmarks.charts import draw_fronts
from benchmarks.rendering.batches import (
    AGENTS,
    VIEW_SIDE_M,
    VIEWS,
    make_scene,
    time_maps,
    time_stack,
    time_threads,
)
from benchmarks.rendering.peers import (
    Draw,
    crop_texture,
    make_distance_renderer,
    make_opencv_renderer,
    make_sampling_grid,
    supersample,
)
from benchmarks.results import ChartFile, JsonFile, Row, print_rows, time_medians, write_rows
from benchmarks.synthetic import draw_place, make_place
from geoaim.rendering import Ground, OrientedBoxes, View, make_ground, prefilter_ground, render

TEXTURE_SIDE_PX = 1024
MIN_TIMED_PIXELS = 1_000_000  # a smaller batch is timed as often as it fits in
# distance between agents in pictures that are compared with the reference
MIN_AGENT_DISTANCE_M = 6.5
Scenes = Sequence[tuple[Tensor, OrientedBoxes]]  # cameras (1, 3), boxes (1, N)


def _draw_texture() -> Float[Tensor, "3 h w"]:
    place = draw_place(make_place(1), resolution=0.1)
    size = (TEXTURE_SIDE_PX, TEXTURE_SIDE_PX)
    image = cv2.resize(place, size, interpolation=cv2.INTER_AREA)
    return torch.tensor(image).permute(2, 0, 1) / 255


def make_map(texture: Float[Tensor, "3 h w"]) -> Ground:
    """Make a ground of a texture, 200 m wide and high around the origin."""
    scale = texture.shape[1] / (2 * VIEW_SIDE_M)
    middle = texture.shape[1] / 2
    return make_ground(texture, torch.tensor([[scale, 0, middle], [0, -scale, middle]]))


def _make_separate_scenes(count: int) -> Scenes:
    """Make scenes of a random camera (1, 3) and boxes (1, N) that do not overlap each other."""
    scenes = []
    for seed in range(count):
        _, cameras, boxes = make_scene(1, 1, seed=seed)
        gaps = torch.cdist(boxes.poses[0, :, :2], boxes.poses[0, :, :2])
        keep = [a for a in range(AGENTS) if not (gaps[a, :a] < MIN_AGENT_DISTANCE_M).any()]
        poses, colours = boxes.poses[:, keep], boxes.colours[:, keep]
        separate = OrientedBoxes(poses, boxes.sizes[keep], colours, heading_colours=1 - colours)
        scenes.append((cameras, separate))
    return scenes


def _make_renderer(ground: Ground) -> Draw:
    """Make this library's renderer of a map."""
    return lambda view, cameras, boxes: render(view, cameras, ground, [boxes])


def _time_renderer(ground: Ground, size: tuple[int, int, int], repeats: int) -> dict[str, Any]:
    """Time forward and backward passes beside `grid_sample` alone on the same texture and grid.

    The size is the side of a view in pixels, the number of views, and that of agents.
    """
    pixels, views, agents = size
    view, cameras, boxes = make_scene(pixels, views, agents)
    texture = crop_texture(ground)
    grid = make_sampling_grid(view, cameras, ground).requires_grad_()
    weight = torch.rand(1, 3, views * pixels, pixels)
    own_weight = weight.view(3, views, pixels, pixels).transpose(0, 1)
    leaves = [x.clone().requires_grad_() for x in (cameras, boxes.poses)]
    prefiltered = prefilter_ground(ground, view.resolution)
    draw, draw_with_opencv = _make_renderer(prefiltered), make_opencv_renderer(ground)
    draw_by_distances = make_distance_renderer(ground)

    def sample() -> Tensor:
        return F.grid_sample(texture, grid, align_corners=False)

    def run(draw: Draw) -> Callable[[], Tensor]:
        return torch.no_grad()(lambda: draw(view, cameras, boxes))

    def differentiate(draw: Draw) -> Callable[[], Any]:
        def run() -> None:
            picture = draw(view, leaves[0], replace(boxes, poses=leaves[1]))
            torch.autograd.grad((picture * own_weight).sum(), leaves)

        return run

    parts: list[Callable[[], Any]] = [
        run(draw),
        torch.no_grad()(sample),
        run(draw_with_opencv),
        differentiate(draw),
        lambda: torch.autograd.grad((sample() * weight).sum(), [grid]),
    ]
    often = repeats * max(1, MIN_TIMED_PIXELS // (views * pixels**2))
    own, alone, opencv, own_both, alone_both = time_medians(parts, often, process_time)
    # timed apart: they evict the caches of whatever is timed beside them
    slow_parts = [f(d) for f in (run, differentiate) for d in (draw, draw_by_distances)]
    beside, slow, beside_both, slow_both = time_medians(slow_parts, 3, process_time)
    return {
        "pixels": pixels,
        "views": views,
        "agents": agents,
        "ms per view": 1e3 * own / views,
        "ratio to grid_sample": own / alone,
        "forward + backward, ms per view": 1e3 * own_both / views,
        "forward + backward, ratio to grid_sample": own_both / alone_both,
        "ratio to OpenCV (no gradient)": own / opencv,
        "soft boxes, ratio to geoaim": slow / beside,
        "soft boxes, forward + backward, ratio to geoaim": slow_both / beside_both,
    }


def _compare_renderers(
    ground: Ground, pixels: int, views: int, repeats: int
) -> list[dict[str, Any]]:
    """Measure speed and errors of each renderer, which draw boxes without triangles."""
    view, cameras, boxes = make_scene(pixels, views)
    texture, grid = crop_texture(ground), make_sampling_grid(view, cameras, ground)
    methods = {
        "geoaim": _make_renderer(prefilter_ground(ground, view.resolution)),
        "geoaim without prefilter_ground": _make_renderer(
            replace(ground, finest=math.inf)  # without its warning
        ),
        "OpenCV: warp, hard polygons": make_opencv_renderer(ground),
        "plain torch: soft boxes everywhere": make_distance_renderer(ground),
    }
    plain = replace(boxes, heading_colours=None)
    parts: list[Callable[[], Any]] = [
        *(lambda draw=draw: draw(view, cameras, plain) for draw in methods.values()),
        lambda: F.grid_sample(texture, grid, align_corners=False),
    ]
    with torch.no_grad():
        *durations, alone = time_medians(parts, repeats, process_time)
    scenes = _make_separate_scenes(4)
    scenes = [(cameras, replace(boxes, heading_colours=None)) for cameras, boxes in scenes]
    return [
        {"method": name, "ratio to grid_sample": duration / alone}
        | _measure_errors(draw, view, ground, scenes)
        for (name, draw), duration in zip(methods.items(), durations, strict=True)
    ]


def _measure_errors(draw: Draw, view: View, ground: Ground, scenes: Scenes) -> dict[str, float]:
    """Measure errors in grey levels, everywhere and where an edge of a box passes."""
    errors, edge_errors = [], []
    dark = replace(ground, image=torch.zeros_like(ground.image))
    for cameras, boxes in scenes:
        error = 255 * (draw(view, cameras, boxes) - supersample(view, cameras, ground, boxes)).abs()
        white = replace(boxes, colours=torch.ones_like(boxes.colours), heading_colours=None)
        cover = render(view, cameras, dark, [white])[:, 0]
        errors.append(error)
        edge_errors.append(error.movedim(1, -1)[(cover > 0.02) & (cover < 0.98)])
    every = torch.cat(errors)
    return {
        "mean error": float(every.mean()),
        "largest error": float(every.max()),
        "mean error at edges of boxes": float(torch.cat(edge_errors).mean()),
    }


def _draw_chart(rows: Sequence[Row]) -> Figure:
    """Draw error over time, for all pixels and for those at edges of boxes."""
    panels = {
        column: [{**row, "error": row[column]} for row in rows]
        for column in ("mean error", "mean error at edges of boxes")
    }
    labels = ("time, grid_sample alone = 1", "error, grey levels")
    return draw_fronts(panels, cost="ratio to grid_sample", error="error", labels=labels)


def main(
    json: JsonFile = None,
    chart: ChartFile = None,
    repeats: Annotated[int, typer.Option(help="of each timing; the median counts")] = 7,
) -> None:
    """Measure speed and errors; print tables, write JSON and a chart."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    ground = make_map(_draw_texture())
    sizes = [(pixels, views, AGENTS) for pixels in (256, 64) for views in (1, 16, 64)]
    sizes += [(256, VIEWS, 100), (64, VIEWS, 100)]
    rows = print_rows(_time_renderer(ground, size, repeats) for size in sizes)
    batches = {
        "maps": print_rows(time_maps(pixels, repeats) for pixels in (64, 128, 256)),
        "threads": print_rows(time_threads(ground, pixels, repeats) for pixels in (256,)),
        "stack": print_rows(time_stack(ground, count, repeats) for count in (1, 10, 50, 200)),
    }
    methods = print_rows(_compare_renderers(ground, 256, 16, repeats))
    if chart:
        _draw_chart(methods).savefig(chart, dpi=110)
    command = f"python -m benchmarks.rendering --repeats {repeats}"
    write_rows(rows, json, command=command, torch=torch.__version__, **batches, methods=methods)
