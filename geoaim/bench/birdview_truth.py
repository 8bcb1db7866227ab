"""What bird's-eye pictures and their gradients should be: means over many points of each pixel.

    python -m geoaim.bench.birdview_truth --json docs/bench/birdview_gradients.json

compares the renderer's gradients with central differences of means over 6765 points.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import torch.nn.functional as F
import typer
from jaxtyping import Float
from torch import Tensor

from geoaim.bench.report import format_table, write_rows
from geoaim.simulation import Ground, OrientedBoxes, View, make_ground, prefilter_ground, render
from geoaim.simulation.rasterization import TRIANGLE_SHARE

COARSE, FINE = (377, 233), (6765, 4181)  # points in a pixel: for pictures, for gradients
CAR = (4.5, 1.9)  # m
STEP = 0.05  # px: of the central differences
POINTS = 2_000_000  # that are looked up at once
Scenes = Sequence[tuple[Tensor, OrientedBoxes]]


def supersampled(
    view: View,
    cameras: Float[Tensor, "B 3"],
    ground: Ground,
    boxes: OrientedBoxes,
    lattice: tuple[int, int] = COARSE,
) -> Float[Tensor, "B C H W"]:
    """Every pixel the mean over the points of a lattice in it, each in a box or not.

    A Fibonacci lattice leaves no row or column of points along an edge, so that the share of a
    pixel in a box comes out several times closer than with as many points on a grid.
    """
    rows, columns = (torch.arange(n).to(cameras) - (n - 1) / 2 for n in (view.height, view.width))
    ahead, right = -rows[:, None] * view.resolution, columns * view.resolution
    every, pictures = torch.arange(lattice[0]).to(cameras), []
    for b, (x, y, heading) in enumerate(cameras):
        c, s = heading.cos(), heading.sin()
        total = torch.zeros(len(ground.image), view.height, view.width).to(cameras)
        for some in torch.split(every, max(1, POINTS // total[0].numel())):
            across = ((some + 0.5) / lattice[0] - 0.5) * view.resolution
            forward = ((some * lattice[1] + 0.5) / lattice[0] % 1 - 0.5) * view.resolution
            moved = torch.stack([x + forward * c + across * s, y + forward * s - across * c], 1)
            moved = F.pad(moved, (0, 1)) + F.pad(heading[None], (2, 0))
            picture = render(view, moved, ground)
            east = moved[:, 0, None, None] + ahead * c + right * s
            north = moved[:, 1, None, None] + ahead * s - right * c
            for a in range(boxes.poses.shape[1]):
                picture = _painted(picture, east, north, boxes, b, a)
            total += picture.sum(0)
        pictures.append(total / lattice[0])
    return torch.stack(pictures)


def _painted(
    picture: Tensor, east: Tensor, north: Tensor, boxes: OrientedBoxes, view: int, agent: int
) -> Tensor:
    """Points in a box in its colour, points in its triangle in that one's."""
    x, y, heading = boxes.poses[view, agent]
    length, width = boxes.sizes.expand(*boxes.poses.shape[:2], 2)[view, agent] / 2
    along = (east - x) * heading.cos() + (north - y) * heading.sin()
    aside = ((north - y) * heading.cos() - (east - x) * heading.sin()).abs()
    inside = (along.abs() < length) & (aside < width)
    tip = inside & (along > (1 - 2 * TRIANGLE_SHARE) * length)
    tip &= aside / width < (length - along) / (2 * TRIANGLE_SHARE * length)
    for where, colours in ((inside, boxes.colours), (tip, boxes.heading_colours)):
        if colours is not None:
            colour = colours.expand(*boxes.poses.shape[:2], -1)[view, agent]
            picture = torch.where(where[:, None], colour[:, None, None], picture)
    return picture


def picture_errors(
    draw: Callable[[View, Tensor, OrientedBoxes], Tensor],
    view: View,
    ground: Ground,
    scenes: Scenes,
) -> dict[str, float]:
    """Grey levels between pictures and the reference: everywhere, and where a box's edge passes."""
    apart, edges = [], []
    for cameras, boxes in scenes:
        error = (draw(view, cameras, boxes) - supersampled(view, cameras, ground, boxes)).abs()
        white = replace(boxes, colours=torch.ones_like(boxes.colours), heading_colours=None)
        cover = render(view, cameras, _black(ground), [white])[:, 0]
        apart.append(255 * error)
        edges.append(255 * error.movedim(1, -1)[(cover > 0.02) & (cover < 0.98)])
    every = torch.cat(apart)
    return {
        "mean": float(every.mean()),
        "largest": float(every.max()),
        "mean at edges of boxes": float(torch.cat(edges).mean()),
    }


def gradient_errors(count: int) -> list[dict[str, Any]]:
    """Relative errors against the reference's central differences, over so many scenes.

    Relative to the gradient's size in the scene, at least to its usual size (root mean square)
    over the scenes: where gradients of opposite edges cancel, what remains has no relative error.
    Along and across, for example, count as one gradient, of the place.
    """
    names = ("x", "y", "heading", "length", "width", "camera x", "camera y", "camera heading")
    kinds = np.array([0, 0, 1, 2, 2, 3, 3, 4])
    found, wanted = np.array([_gradients(seed) for seed in range(count)]).swapaxes(0, 1)
    own = np.stack([np.hypot.reduce(wanted[:, kinds == k], axis=1) for k in kinds], axis=1)
    usual = np.sqrt((own**2).mean(axis=0))
    error = 100 * np.abs(found - wanted) / np.maximum(own, usual)
    strict = 100 * np.abs(found - wanted) / own
    return [
        {
            "gradient by": name,
            "median error, %": float(np.median(error[:, k])),
            "worst error, %": float(error[:, k].max()),
            "over 10 % of the scene's own": int((strict[:, k] > 10).sum()),
        }
        for k, name in enumerate(names)
    ]


def _gradients(seed: int) -> tuple[list[float], list[float]]:
    """Gradients of a weighted sum over a picture of one agent on smooth ground: ours, and wanted.

    By the agent's and the camera's pose and the agent's size, for moves of `STEP` at its corners.
    """
    generator = torch.Generator().manual_seed(seed)
    random = torch.rand(8, generator=generator, dtype=torch.float64)
    view = View(24, 24, 0.5)
    v, u = torch.meshgrid(torch.arange(80.0), torch.arange(80.0), indexing="ij")
    image = (0.5 + 0.4 * torch.sin(u / 7 + 6 * random[0]) * torch.cos(v / 9)).double()[None]
    ground = make_ground(image, torch.tensor([[2.0, 0, 40], [0, -2.0, 40]]).double())
    fitted = prefilter_ground(ground, view.resolution)
    across = torch.linspace(-1, 1, view.width, dtype=torch.float64)
    weight = (
        across[:, None] * torch.cos(3 * across + 6 * random[1]) + torch.sin(5 * across)[:, None]
    )
    pose = torch.stack([6 * random[2] - 3, 6 * random[3] - 3, 6.28 * random[4]])
    size = torch.tensor(CAR, dtype=torch.float64)
    values = torch.cat([pose, size, random[5:8] * torch.tensor([2.0, 2.0, 6.28])])

    def boxes(values: Tensor) -> OrientedBoxes:
        return OrientedBoxes(values[None, None, :3], values[None, 3:5], torch.ones(1, 1).double())

    def loss(values: Tensor) -> Tensor:
        picture = supersampled(view, values[None, 5:], ground, boxes(values), FINE)
        return (picture[0, 0] * weight).sum()

    exact = values.clone().requires_grad_()
    picture = render(view, exact[None, 5:], fitted, [boxes(exact)])
    (gradient,) = torch.autograd.grad((picture[0, 0] * weight).sum(), exact)
    steps = torch.tensor([1.0, 1, 0.2, 1, 1, 1, 1, 0.05]).double() * STEP * view.resolution
    wanted = [float((loss(values + m) - loss(values - m)) / 2) for m in torch.diag(steps)]
    return (gradient * steps).tolist(), wanted


def _black(ground: Ground) -> Ground:
    dark = torch.zeros_like(ground.image)
    return Ground(dark, ground.coverage, ground.image_from_world)


def main(
    json: Annotated[Path | None, typer.Option(help="where to write the figures")] = None,
    scenes: Annotated[int, typer.Option(help="how many")] = 200,
) -> None:
    """Compare gradients over random scenes; print a table, and write JSON when asked."""
    torch.set_num_threads(1)
    rows = gradient_errors(scenes)
    print(format_table(rows))
    command = f"python -m geoaim.bench.birdview_truth --scenes {scenes}"
    write_rows(rows, json, command=command, torch=torch.__version__)


if __name__ == "__main__":
    typer.run(main)
