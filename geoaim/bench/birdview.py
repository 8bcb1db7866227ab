"""The bird's-eye renderer against `grid_sample` alone, OpenCV, plain torch, and a reference.

    python -m geoaim.bench.birdview --json docs/bench/birdview.json \\
        --chart docs/images/birdview.png

Speed: 20 agents, views of 100 m, a texture of 1024 x 1024 px over 200 m, one thread. The parts of a
row are timed in turn, and medians compared. Accuracy: a pixel of the reference is the mean of 377
points. Gradients are compared in `birdview_truth`.
"""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import matplotlib.pyplot as plt
import numpy as np
import torch
import torch.nn.functional as F
import typer
from jaxtyping import Float
from torch import Tensor

from geoaim.bench.birdview_peers import make_sampling_grid, render_by_distances, render_with_opencv
from geoaim.bench.birdview_truth import CAR_SIZE_M, Scenes, measure_errors
from geoaim.bench.report import format_table, measure_peak_megabytes, time_medians, write_rows
from geoaim.simulation import Ground, OrientedBoxes, View, make_ground, prefilter_ground, render
from geoaim.synthetic import draw_place, make_place

VIEW_SIDE_M, TEXTURE_SIDE_PX, AGENTS = 100.0, 1024, 20
MIN_TIMED_PIXELS = 1_000_000  # a smaller batch is timed as often as it fits in
MIN_GAP_M = 6.5  # between agents in pictures that are compared with the reference
Draw = Callable[[View, Tensor, OrientedBoxes], Tensor]


@dataclass(frozen=True, eq=False)
class Setup:
    """What all renderers draw.

    Attributes:
        view: size and resolution of the pictures.
        ground: the map; prefiltered for the view; and as numpy image (h, w, 3).
        cameras: (B, 3).
        boxes: around each camera.
    """

    view: View
    ground: Ground
    prefiltered: Ground
    image: np.ndarray
    cameras: Tensor
    boxes: OrientedBoxes

    @property
    def texture(self) -> Float[Tensor, "1 3 h w"]:
        """The texture without its border."""
        return self.ground.image[None, :, 1:-1, 1:-1].contiguous()


def draw_texture() -> Float[Tensor, "3 h w"]:
    """Draw a synthetic junction."""
    place = draw_place(make_place(1), resolution=0.1)
    size = (TEXTURE_SIDE_PX, TEXTURE_SIDE_PX)
    image = cv2.resize(place, size, interpolation=cv2.INTER_AREA)
    return torch.tensor(image).permute(2, 0, 1) / 255


def make_map(texture: Float[Tensor, "3 h w"]) -> Ground:
    """Make a ground of 200 m around the origin."""
    scale = texture.shape[1] / (2 * VIEW_SIDE_M)
    middle = texture.shape[1] / 2
    return make_ground(texture, torch.tensor([[scale, 0, middle], [0, -scale, middle]]))


def make_cameras(
    count: int, seed: int, dtype: torch.dtype = torch.float32
) -> tuple[Tensor, OrientedBoxes]:
    """Make random cameras on the map, with agents around each.

    Args:
        count: number of cameras.
        seed: of the random numbers.
        dtype: of all numbers.

    Returns:
        (B, 3) cameras; (B, `AGENTS`) boxes.
    """
    generator = torch.Generator().manual_seed(seed)
    random = torch.rand(count, AGENTS + 1, 6, generator=generator, dtype=torch.float64).to(dtype)
    cameras = torch.cat([random[:, 0, :2] * 60 - 30, random[:, 0, 2:3] * 6.28], 1)
    positions = cameras[:, None, :2] + (random[:, 1:, :2] - 0.5) * 0.8 * VIEW_SIDE_M
    poses = torch.cat([positions, random[:, 1:, 2:3] * 6.28], 2)
    sizes = torch.tensor([CAR_SIZE_M], dtype=dtype).expand(AGENTS, 2)
    colours = random[:, 1:, 3:]
    return cameras, OrientedBoxes(poses, sizes, colours, heading_colours=1 - colours)


def make_separate_scenes(count: int, dtype: torch.dtype) -> Scenes:
    """Make random cameras without agents that overlap others."""
    scenes = []
    for seed in range(count):
        cameras, boxes = make_cameras(1, seed, dtype)
        gaps = torch.cdist(boxes.poses[0, :, :2], boxes.poses[0, :, :2])
        keep = [a for a in range(AGENTS) if not (gaps[a, :a] < MIN_GAP_M).any()]
        poses, colours = boxes.poses[:, keep], boxes.colours[:, keep]
        separate = OrientedBoxes(poses, boxes.sizes[keep], colours, heading_colours=1 - colours)
        scenes.append((cameras, separate))
    return scenes


def make_setup(ground: Ground, pixels: int, views: int) -> Setup:
    """Make what the renderers draw.

    Args:
        ground: the map.
        pixels: of a side of the pictures.
        views: number of cameras.

    Returns:
        Random cameras and boxes.
    """
    view = View(pixels, pixels, VIEW_SIDE_M / pixels)
    image = np.ascontiguousarray(ground.image[:, 1:-1, 1:-1].permute(1, 2, 0).numpy())
    fitted = prefilter_ground(ground, view.resolution)
    return Setup(view, ground, fitted, image, *make_cameras(views, 1))


def time_renderer(ground: Ground, pixels: int, views: int, repeats: int) -> dict[str, Any]:
    """Time forward and backward passes beside `grid_sample` alone on the same texture and grid.

    Args:
        ground: the map.
        pixels: of a side of the pictures.
        views: number of cameras.
        repeats: of each timing, for batches of `MIN_TIMED_PIXELS` or more.

    Returns:
        Times and ratios by name.
    """
    setup = make_setup(ground, pixels, views)
    view, cameras, boxes, texture = setup.view, setup.cameras, setup.boxes, setup.texture
    grid = make_sampling_grid(view, cameras, ground).requires_grad_()
    weight = torch.rand(1, 3, views * pixels, pixels)
    own_weight = weight.view(3, views, pixels, pixels).transpose(0, 1)
    leaves = [x.clone().requires_grad_() for x in (cameras, boxes.poses)]

    def sample() -> Tensor:
        return F.grid_sample(texture, grid, align_corners=False)

    def draw(cameras: Tensor = cameras, poses: Tensor = boxes.poses) -> Tensor:
        return render(view, cameras, setup.prefiltered, [replace(boxes, poses=poses)])

    def draw_by_distances(cameras: Tensor = cameras, poses: Tensor = boxes.poses) -> Tensor:
        return render_by_distances(view, cameras, texture, grid, replace(boxes, poses=poses))

    def differentiate(draw: Callable[..., Tensor]) -> None:
        torch.autograd.grad((draw(*leaves) * own_weight).sum(), leaves)

    forward = torch.no_grad()(draw)
    parts: list[Callable[[], Any]] = [
        forward,
        torch.no_grad()(sample),
        lambda: render_with_opencv(view, cameras, ground, boxes, setup.image),
        lambda: differentiate(draw),
        lambda: torch.autograd.grad((sample() * weight).sum(), [grid]),
    ]
    often = repeats * max(1, MIN_TIMED_PIXELS // (views * pixels**2))
    own, alone, opencv, own_both, alone_both = time_medians(parts, often)
    # timed apart: it evicts the caches of whatever is timed beside it
    slow_parts: list[Callable[[], Any]] = [
        forward,
        torch.no_grad()(draw_by_distances),
        lambda: differentiate(draw),
        lambda: differentiate(draw_by_distances),
    ]
    beside, slow, beside_both, slow_both = time_medians(slow_parts, 3)
    return {
        "pixels": pixels,
        "views": views,
        "ms per view": 1e3 * own / views,
        "ratio to grid_sample": own / alone,
        "forward + backward, ms per view": 1e3 * own_both / views,
        "forward + backward, ratio to grid_sample": own_both / alone_both,
        "ratio to OpenCV (no gradient)": own / opencv,
        "plain torch, ratio to geoaim": slow / beside,
        "plain torch, forward + backward, ratio to geoaim": slow_both / beside_both,
    }


def compare_renderers(
    ground: Ground, pixels: int, views: int, repeats: int
) -> list[dict[str, Any]]:
    """Measure speed and errors of each renderer, which draw boxes without triangles.

    Args:
        ground: the map.
        pixels: of a side of the pictures.
        views: number of cameras.
        repeats: of each timing.

    Returns:
        A row for each renderer.
    """
    setup = make_setup(ground, pixels, views)
    texture, grid = setup.texture, make_sampling_grid(setup.view, setup.cameras, ground)

    def draw_with_opencv(view: View, cameras: Tensor, boxes: OrientedBoxes) -> Tensor:
        pictures = render_with_opencv(view, cameras, ground, boxes, setup.image)
        return torch.tensor(np.stack(pictures)).permute(0, 3, 1, 2)

    def draw_by_distances(view: View, cameras: Tensor, boxes: OrientedBoxes) -> Tensor:
        own_grid = make_sampling_grid(view, cameras, ground)
        return render_by_distances(view, cameras, texture, own_grid, boxes)

    methods: dict[str, Draw] = {
        "geoaim": lambda view, cameras, boxes: render(view, cameras, setup.prefiltered, [boxes]),
        "geoaim without prefilter_ground": lambda v, c, b: render(v, c, ground, [b]),
        "OpenCV: warp, hard polygons": draw_with_opencv,
        "plain torch: soft boxes everywhere": draw_by_distances,
    }
    plain = replace(setup.boxes, heading_colours=None)
    parts: list[Callable[[], Any]] = [
        *(lambda draw=draw: draw(setup.view, setup.cameras, plain) for draw in methods.values()),
        lambda: F.grid_sample(texture, grid, align_corners=False),
    ]
    with torch.no_grad():
        *durations, alone = time_medians(parts, repeats)
    scenes = make_separate_scenes(4, torch.float32)
    scenes = [(cameras, replace(boxes, heading_colours=None)) for cameras, boxes in scenes]
    return [
        {"method": name, "ratio to grid_sample": duration / alone}
        | measure_errors(draw, setup.view, ground, scenes)
        for (name, draw), duration in zip(methods.items(), durations, strict=True)
    ]


def measure_sizes(ground: Ground, pixels: int) -> dict[str, Any]:
    """Measure the errors of pictures of `pixels` x `pixels`."""
    view = View(pixels, pixels, VIEW_SIDE_M / pixels)
    fitted = prefilter_ground(ground, view.resolution)

    def draw(view: View, cameras: Tensor, boxes: OrientedBoxes) -> Tensor:
        return render(view, cameras, fitted, [boxes])

    scenes = make_separate_scenes(4, torch.float64)
    return {"pixels": pixels} | measure_errors(draw, view, ground, scenes)


def measure_memory(pixels: int, views: int) -> float:
    """Measure megabytes per view of a forward and backward pass: of more views in a new process."""
    code = "from geoaim.bench.birdview import measure_peak; print(measure_peak({}, {}))"
    peaks = [
        float(subprocess.check_output([sys.executable, "-c", code.format(pixels, count)]))
        for count in (views, 2 * views)
    ]
    return (peaks[1] - peaks[0]) / views


def measure_peak(pixels: int, views: int) -> float:
    """Measure the peak memory of this process, with one forward and backward pass, megabytes."""
    torch.set_num_threads(1)
    view = View(pixels, pixels, VIEW_SIDE_M / pixels)
    texture = torch.rand(3, TEXTURE_SIDE_PX, TEXTURE_SIDE_PX)
    ground = prefilter_ground(make_map(texture), view.resolution)
    cameras, boxes = make_cameras(views, 1)
    leaves = [x.clone().requires_grad_() for x in (cameras, boxes.poses)]
    picture = render(view, leaves[0], ground, [replace(boxes, poses=leaves[1])])
    torch.autograd.grad(picture.sum(), leaves)
    return measure_peak_megabytes()


def draw_chart(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw error over time, for all pixels and for those at edges of boxes."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained", sharex=True)
    for axis, column in zip(axes, ("mean error", "mean error at edges of boxes"), strict=True):
        for row in rows:
            axis.semilogy(row["ratio to grid_sample"], row[column], "o", ms=10, label=row["method"])
        axis.axvline(1.0, color="grey", linestyle=":")
        axis.set(xlabel="time, grid_sample alone = 1", ylabel=f"{column}, grey levels")
        axis.grid(visible=True, which="both", alpha=0.3)
        axis.set_xlim(left=0)
    axes[0].legend(loc="center right")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main(
    json: Annotated[Path | None, typer.Option(help="JSON file to write")] = None,
    chart: Annotated[Path | None, typer.Option(help="chart of speed and accuracy to write")] = None,
    repeats: Annotated[int, typer.Option(help="of each timing; the median counts")] = 7,
) -> None:
    """Measure speed, memory and errors; print tables, write JSON and a chart."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    texture = draw_texture()
    ground, exact = make_map(texture), make_map(texture.double())
    sizes = [(pixels, views) for pixels in (256, 64) for views in (1, 16, 64)]
    rows = [time_renderer(ground, pixels, views, repeats) for pixels, views in sizes]
    print(format_table(rows), flush=True)
    methods = compare_renderers(ground, 256, 16, repeats)
    print(format_table(methods), flush=True)
    if chart:
        draw_chart(methods, chart)
    errors = [measure_sizes(exact, pixels) for pixels in (256, 128, 64)]
    megabytes = measure_memory(256, 64)
    print(format_table(errors), f"{megabytes:.1f} MB per view", sep="\n\n", flush=True)
    command = f"python -m geoaim.bench.birdview --repeats {repeats}"
    more = {"methods": methods, "errors": errors, "megabytes_per_view": megabytes}
    write_rows(rows, json, command=command, torch=torch.__version__, **more)


if __name__ == "__main__":
    typer.run(main)
