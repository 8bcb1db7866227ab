"""The bird's-eye renderer against `grid_sample` alone, OpenCV, plain torch, and a finer truth.

    python -m geoaim.bench.birdview --json docs/bench/birdview.json \\
        --chart docs/images/birdview.png

Speed: 20 agents, views of 100 m, a texture of 1024 x 1024 px over 200 m, one thread; the parts of
a row are timed in turn, and medians compared. Accuracy: every pixel of the reference is the mean
of 377 points. Gradients are compared in `birdview_truth`.
"""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
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

from geoaim.bench.birdview_peers import by_dense_torch, by_opencv, sampling_grid
from geoaim.bench.birdview_truth import CAR, picture_errors
from geoaim.bench.report import format_table, measure_peak_megabytes, time_medians, write_rows
from geoaim.simulation import Ground, OrientedBoxes, View, make_ground, prefilter_ground, render
from geoaim.synthetic import draw_place, make_place

SIDE, TEXTURE, AGENTS = 100.0, 1024, 20
MANY = 1_000_000  # pixels: smaller batches are timed as often as they go into it
APART = 6.5  # m between the agents whose pictures are compared with the reference


def picture_of_place() -> Float[Tensor, "3 h w"]:
    """A made junction."""
    place = draw_place(make_place(1), resolution=0.1)
    image = cv2.resize(place, (TEXTURE, TEXTURE), interpolation=cv2.INTER_AREA)
    return torch.tensor(image).permute(2, 0, 1) / 255


def on_map(texture: Float[Tensor, "3 h w"]) -> Ground:
    """A ground of 200 m around the origin."""
    scale = TEXTURE / (2 * SIDE)
    matrix = torch.tensor([[scale, 0, TEXTURE / 2], [0, -scale, TEXTURE / 2]])
    return make_ground(texture, matrix)


def scene(
    views: int, seed: int, dtype: torch.dtype = torch.float32
) -> tuple[Tensor, OrientedBoxes]:
    """Cameras on the map, each with agents around it."""
    generator = torch.Generator().manual_seed(seed)
    random = torch.rand(views, AGENTS + 1, 6, generator=generator, dtype=torch.float64).to(dtype)
    cameras = torch.cat([random[:, 0, :2] * 60 - 30, random[:, 0, 2:3] * 6.28], 1)
    places = cameras[:, None, :2] + (random[:, 1:, :2] - 0.5) * 0.8 * SIDE
    poses = torch.cat([places, random[:, 1:, 2:3] * 6.28], 2)
    sizes = torch.tensor([CAR], dtype=dtype).expand(AGENTS, 2)
    return cameras, OrientedBoxes(
        poses, sizes, random[:, 1:, 3:], heading_colours=1 - random[:, 1:, 3:]
    )


def scenes_apart(count: int, dtype: torch.dtype) -> list[tuple[Tensor, OrientedBoxes]]:
    """Single views without agents that would stand in others."""
    found = []
    for seed in range(count):
        cameras, boxes = scene(1, seed, dtype)
        gaps = torch.cdist(boxes.poses[0, :, :2], boxes.poses[0, :, :2])
        keep = [a for a in range(AGENTS) if not (gaps[a, :a] < APART).any()]
        assert boxes.heading_colours is not None
        colours, noses = boxes.colours[:, keep], boxes.heading_colours[:, keep]
        found.append(
            (
                cameras,
                OrientedBoxes(
                    boxes.poses[:, keep], boxes.sizes[keep], colours, heading_colours=noses
                ),
            )
        )
    return found


def speed(ground: Ground, pixels: int, views: int, repeats: int) -> dict[str, Any]:
    """Forward and backward, against `grid_sample` alone of the same texture and grid."""
    view = View(pixels, pixels, SIDE / pixels)
    fitted = prefilter_ground(ground, view.resolution)
    cameras, boxes = scene(views, 1)
    texture = ground.image[None, :, 1:-1, 1:-1].contiguous()
    grid = sampling_grid(view, cameras, ground).requires_grad_()
    weight = torch.rand(1, 3, views * pixels, pixels)
    own = weight.view(3, views, pixels, pixels).transpose(0, 1)
    given = [x.clone().requires_grad_() for x in (cameras, boxes.poses)]
    image = np.ascontiguousarray(texture[0].permute(1, 2, 0).numpy())

    def backward(draw: Callable[[], Tensor], weight: Tensor, leaves: list[Tensor]) -> None:
        torch.autograd.grad((draw() * weight).sum(), leaves)

    def alone() -> Tensor:
        return F.grid_sample(texture, grid, align_corners=False)

    def ours(poses: Tensor, cameras: Tensor) -> Tensor:
        return render(view, cameras, fitted, [replace(boxes, poses=poses)])

    def dense(poses: Tensor, cameras: Tensor) -> Tensor:
        return by_dense_torch(view, cameras, texture, grid, replace(boxes, poses=poses))

    def forward() -> None:
        with torch.no_grad():
            ours(boxes.poses, cameras)

    def there_and_back() -> None:
        backward(lambda: ours(given[1], given[0]), own, given)

    often = repeats * max(1, MANY // (views * pixels**2))
    quick, sample, cv, quick_both, sample_both = time_medians(
        [
            forward,
            torch.no_grad()(alone),
            lambda: by_opencv(view, cameras, ground, boxes, image),
            there_and_back,
            lambda: backward(alone, weight, [grid]),
        ],
        often,
    )
    beside, plain, beside_both, plain_both = time_medians(  # apart: it leaves no cache as it was
        [
            forward,
            torch.no_grad()(lambda: dense(boxes.poses, cameras)),
            there_and_back,
            lambda: backward(lambda: dense(given[1], given[0]), own, given),
        ],
        3,
    )
    return {
        "pixels": pixels,
        "views": views,
        "ms a view": 1e3 * quick / views,
        "times grid_sample": quick / sample,
        "forward + backward, ms": 1e3 * quick_both / views,
        "times grid_sample's": quick_both / sample_both,
        "times OpenCV (no gradient)": quick / cv,
        "plain torch is slower by": plain / beside,
        "with backward": plain_both / beside_both,
    }


def against_peers(ground: Ground, pixels: int, views: int, repeats: int) -> list[dict[str, Any]]:
    """Speed and error of each way to draw the ground with boxes, none of them with triangles."""
    view = View(pixels, pixels, SIDE / pixels)
    fitted = prefilter_ground(ground, view.resolution)
    texture = ground.image[None, :, 1:-1, 1:-1].contiguous()
    image = np.ascontiguousarray(texture[0].permute(1, 2, 0).numpy())

    def opencv(view: View, cameras: Tensor, boxes: OrientedBoxes) -> Tensor:
        pictures = by_opencv(view, cameras, ground, boxes, image)
        return torch.tensor(np.stack(pictures)).permute(0, 3, 1, 2)

    def dense(view: View, cameras: Tensor, boxes: OrientedBoxes) -> Tensor:
        grid = sampling_grid(view, cameras, ground)
        return by_dense_torch(view, cameras, texture, grid, boxes)

    ways: dict[str, Callable[[View, Tensor, OrientedBoxes], Tensor]] = {
        "geoaim": lambda v, c, b: render(v, c, fitted, [b]),
        "geoaim without prefilter_ground": lambda v, c, b: render(v, c, ground, [b]),
        "OpenCV: warp, hard polygons": opencv,
        "plain torch: soft boxes everywhere": dense,
    }
    cameras, boxes = scene(views, 1)
    bare = replace(boxes, heading_colours=None)
    grid = sampling_grid(view, cameras, ground)
    timed: list[Callable[[], Any]] = [
        *(lambda draw=draw: draw(view, cameras, bare) for draw in ways.values()),
        lambda: F.grid_sample(texture, grid, align_corners=False),
    ]
    with torch.no_grad():
        *seconds, alone = time_medians(timed, repeats)
    few = [(c, replace(b, heading_colours=None)) for c, b in scenes_apart(4, torch.float32)]
    return [
        {"way": name, "times grid_sample": time / alone} | picture_errors(draw, view, ground, few)
        for (name, draw), time in zip(ways.items(), seconds, strict=True)
    ]


def errors_at(ground: Ground, pixels: int) -> dict[str, Any]:
    """Grey levels between pictures of some scenes and the reference."""
    view = View(pixels, pixels, SIDE / pixels)
    fitted = prefilter_ground(ground, view.resolution)

    def draw(view: View, cameras: Tensor, boxes: OrientedBoxes) -> Tensor:
        return render(view, cameras, fitted, [boxes])

    return {"pixels": pixels} | picture_errors(draw, view, ground, scenes_apart(4, torch.float64))


def memory(pixels: int, views: int) -> float:
    """Megabytes a view that forward and backward take: of so many views more, in two processes."""
    code = "from geoaim.bench.birdview import _held; print(_held({}, {}))"
    held = [
        float(subprocess.check_output([sys.executable, "-c", code.format(pixels, count)]))
        for count in (views, 2 * views)
    ]
    return (held[1] - held[0]) / views


def _held(pixels: int, views: int) -> float:
    """The most megabytes that this process has held, with one batch forward and backward."""
    torch.set_num_threads(1)
    view = View(pixels, pixels, SIDE / pixels)
    ground = prefilter_ground(on_map(torch.rand(3, TEXTURE, TEXTURE)), view.resolution)
    cameras, boxes = scene(views, 1)
    given = [x.clone().requires_grad_() for x in (cameras, boxes.poses)]
    picture = render(view, given[0], ground, [replace(boxes, poses=given[1])])
    torch.autograd.grad(picture.sum(), given)
    return measure_peak_megabytes()


def chart(rows: list[dict[str, Any]], path: Path) -> None:
    """Time against error, for all pixels and for those at edges of boxes."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained", sharex=True)
    for axis, column in zip(axes, ("mean", "mean at edges of boxes"), strict=True):
        for row in rows:
            axis.semilogy(row["times grid_sample"], row[column], "o", ms=10, label=row["way"])
        axis.axvline(1.0, color="grey", linestyle=":")
        axis.set(xlabel="time, grid_sample alone = 1", ylabel=f"error, grey levels: {column}")
        axis.grid(visible=True, which="both", alpha=0.3)
        axis.set_xlim(left=0)
    axes[0].legend(loc="center right")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main(
    json: Annotated[Path | None, typer.Option(help="where to write the figures")] = None,
    chart_path: Annotated[Path | None, typer.Option("--chart", help="speed against error")] = None,
    repeats: Annotated[int, typer.Option(help="of each timing; the median counts")] = 7,
) -> None:
    """Measure speed, memory and pictures; print tables, write JSON and a chart when asked."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    texture = picture_of_place()
    ground, exact = on_map(texture), on_map(texture.double())
    rows = [speed(ground, pixels, views, repeats) for pixels in (256, 64) for views in (1, 16, 64)]
    print(format_table(rows), flush=True)
    ways = against_peers(ground, 256, 16, repeats)
    print(format_table(ways), flush=True)
    if chart_path:
        chart(ways, chart_path)
    pictures = [errors_at(exact, pixels) for pixels in (256, 128, 64)]
    megabytes = memory(256, 64)
    print(format_table(pictures), f"{megabytes:.1f} MB a view", sep="\n\n", flush=True)
    command = f"python -m geoaim.bench.birdview --repeats {repeats}"
    more = {"ways": ways, "pictures": pictures, "megabytes_a_view": megabytes}
    write_rows(rows, json, command=command, torch=torch.__version__, **more)


if __name__ == "__main__":
    typer.run(main)
