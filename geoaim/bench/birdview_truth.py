"""Reference for bird's-eye pictures and their gradients: means over many points of each pixel.

    python -m geoaim.bench.birdview_truth --json docs/bench/birdview_gradients.json

compares the renderer's gradients with central differences of means over 6765 points.
"""

from typing import Annotated, Any

import numpy as np
import torch
import torch.nn.functional as F
import typer
from jaxtyping import Float
from torch import Tensor

from geoaim.bench.report import JsonFile, print_rows, write_rows
from geoaim.simulation import Ground, OrientedBoxes, View, make_ground, prefilter_ground, render
from geoaim.simulation.rasterization import TRIANGLE_SHARE

# Fibonacci lattices: points in a pixel and the generator; for pictures, and for gradients
PICTURE_LATTICE, GRADIENT_LATTICE = (377, 233), (6765, 4181)
CAR_SIZE_M = (4.5, 1.9)
DIFFERENCE_STEP_PX = 0.05  # by which corners move in central differences
MAX_POINTS = 2_000_000  # that are rendered at once


def supersample(
    view: View,
    cameras: Float[Tensor, "B 3"],
    ground: Ground,
    boxes: OrientedBoxes,
    lattice: tuple[int, int] = PICTURE_LATTICE,
) -> Float[Tensor, "B C H W"]:
    """Render pictures whose pixels are means over the points of a lattice, each in a box or not.

    A Fibonacci lattice has no row or column of points along an edge. The covered share of a pixel
    comes out several times closer than by a square grid of as many points.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3) x, y, heading.
        ground: the map.
        boxes: in paint order.
        lattice: number of points and generator.

    Returns:
        (B, C, H, W).
    """
    rows, columns = (torch.arange(n).to(cameras) - (n - 1) / 2 for n in (view.height, view.width))
    ahead, right = -rows[:, None] * view.resolution, columns * view.resolution
    points, pictures = torch.arange(lattice[0]).to(cameras), []
    for b, (x, y, heading) in enumerate(cameras):
        c, s = heading.cos(), heading.sin()
        total = torch.zeros(len(ground.image), view.height, view.width).to(cameras)
        for some in torch.split(points, max(1, MAX_POINTS // total[0].numel())):
            across = ((some + 0.5) / lattice[0] - 0.5) * view.resolution
            forward = ((some * lattice[1] + 0.5) / lattice[0] % 1 - 0.5) * view.resolution
            shifted = torch.stack([x + forward * c + across * s, y + forward * s - across * c], 1)
            shifted = F.pad(shifted, (0, 1)) + F.pad(heading[None], (2, 0))
            picture = render(view, shifted, ground)
            east = shifted[:, 0, None, None] + ahead * c + right * s
            north = shifted[:, 1, None, None] + ahead * s - right * c
            for a in range(boxes.poses.shape[1]):
                picture = _paint_box(picture, (east, north), boxes, b, a)
            total += picture.sum(0)
        pictures.append(total / lattice[0])
    return torch.stack(pictures)


def _paint_box(
    picture: Tensor, position: tuple[Tensor, Tensor], boxes: OrientedBoxes, view: int, agent: int
) -> Tensor:
    """Paint the points in a box, and those in its triangle."""
    x, y, heading = boxes.poses[view, agent]
    east, north = position[0] - x, position[1] - y
    length, width = boxes.sizes.expand(*boxes.poses.shape[:2], 2)[view, agent] / 2
    along = east * heading.cos() + north * heading.sin()
    aside = (north * heading.cos() - east * heading.sin()).abs()
    in_box = (along.abs() < length) & (aside < width)
    in_triangle = in_box & (along > (1 - 2 * TRIANGLE_SHARE) * length)
    in_triangle &= aside / width < (length - along) / (2 * TRIANGLE_SHARE * length)
    for mask, colours in ((in_box, boxes.colours), (in_triangle, boxes.heading_colours)):
        if colours is not None:
            colour = colours.expand(*boxes.poses.shape[:2], -1)[view, agent]
            picture = torch.where(mask[:, None], colour[:, None, None], picture)
    return picture


def measure_gradient_errors(count: int) -> list[dict[str, Any]]:
    """Measure relative errors of gradients against central differences of the reference.

    An error is divided by the gradient's size in its scene, or by the root mean square over the
    scenes if that is larger: where gradients of opposite edges cancel, the rest has no meaningful
    relative error. Components of one vector, such as x and y, share one size. A row is of one of
    eight variables, over `count` random scenes.
    """
    names = ("x", "y", "heading", "length", "width", "camera x", "camera y", "camera heading")
    vectors = np.array([0, 0, 1, 2, 2, 3, 3, 4])
    found, wanted = np.array([_compute_gradients(seed) for seed in range(count)]).swapaxes(0, 1)
    own = np.stack([np.hypot.reduce(wanted[:, vectors == k], axis=1) for k in vectors], axis=1)
    typical = np.sqrt((own**2).mean(axis=0))
    error = 100 * np.abs(found - wanted) / np.maximum(own, typical)
    strict = 100 * np.abs(found - wanted) / own
    return [
        {
            "gradient by": name,
            "median error, %": float(np.median(error[:, k])),
            "largest error, %": float(error[:, k].max()),
            "over 10 % of the scene's own": int((strict[:, k] > 10).sum()),
        }
        for k, name in enumerate(names)
    ]


def _compute_gradients(seed: int) -> tuple[list[float], list[float]]:
    """Compute gradients of a weighted sum over a picture: the renderer's, and the reference's.

    The picture shows one agent on smooth ground. Gradients are by the agent's pose and size and
    the camera's pose, for changes that move corners by `DIFFERENCE_STEP_PX`.
    """
    view, ground, weight, values = _make_gradient_scene(seed)
    fitted = prefilter_ground(ground, view.resolution)

    def make_box(values: Tensor) -> OrientedBoxes:
        return OrientedBoxes(values[None, None, :3], values[None, 3:5], torch.ones(1, 1).double())

    def weigh_reference(values: Tensor) -> Tensor:
        lattice = GRADIENT_LATTICE
        picture = supersample(view, values[None, 5:], ground, make_box(values), lattice)
        return (picture[0, 0] * weight).sum()

    leaf = values.clone().requires_grad_()
    picture = render(view, leaf[None, 5:], fitted, [make_box(leaf)])
    (gradient,) = torch.autograd.grad((picture[0, 0] * weight).sum(), leaf)
    steps = torch.tensor([1.0, 1, 0.2, 1, 1, 1, 1, 0.05]).double()
    steps = steps * DIFFERENCE_STEP_PX * view.resolution
    wanted = [
        float((weigh_reference(values + move) - weigh_reference(values - move)) / 2)
        for move in torch.diag(steps)
    ]
    return (gradient * steps).tolist(), wanted


def _make_gradient_scene(seed: int) -> tuple[View, Ground, Tensor, Tensor]:
    """Make a random view, smooth ground, weights (H, W), and box pose, box size and camera (8,)."""
    generator = torch.Generator().manual_seed(seed)
    random = torch.rand(8, generator=generator, dtype=torch.float64)
    view = View(24, 24, 0.5)
    v, u = torch.meshgrid(torch.arange(80.0), torch.arange(80.0), indexing="ij")
    image = (0.5 + 0.4 * torch.sin(u / 7 + 6 * random[0]) * torch.cos(v / 9)).double()[None]
    ground = make_ground(image, torch.tensor([[2.0, 0, 40], [0, -2.0, 40]]).double())
    across = torch.linspace(-1, 1, view.width, dtype=torch.float64)
    weight = (
        across[:, None] * torch.cos(3 * across + 6 * random[1]) + torch.sin(5 * across)[:, None]
    )
    pose = torch.stack([6 * random[2] - 3, 6 * random[3] - 3, 6.28 * random[4]])
    size = torch.tensor(CAR_SIZE_M, dtype=torch.float64)
    values = torch.cat([pose, size, random[5:8] * torch.tensor([2.0, 2.0, 6.28])])
    return view, ground, weight, values


def main(
    json: JsonFile = None,
    scenes: Annotated[int, typer.Option(help="number of random scenes")] = 200,
) -> None:
    """Compare gradients with central differences; print a table and write JSON."""
    torch.set_num_threads(1)
    rows = print_rows(measure_gradient_errors(scenes))
    command = f"python -m geoaim.bench.birdview_truth --scenes {scenes}"
    write_rows(rows, json, command=command, torch=torch.__version__)


if __name__ == "__main__":
    typer.run(main)
