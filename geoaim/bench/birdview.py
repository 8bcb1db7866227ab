"""The bird's-eye renderer against `grid_sample` alone, OpenCV, and 256 points a pixel.

    python -m geoaim.bench.birdview --json docs/bench/birdview.json

Speed: 20 agents, views of 100 m, a texture of 1024 x 1024 px over 200 m, one thread; the parts of
a row are timed in turn, and medians compared. Accuracy: every pixel of the reference is the mean
of 377 points; gradients are compared with central differences of one of 6765.
"""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F
import typer
from jaxtyping import Float
from torch import Tensor

from geoaim.bench.report import medians, peak_megabytes, save, table
from geoaim.geometry import to_opencv
from geoaim.simulation import Boxes, Ground, View, fit_ground, make_ground, render
from geoaim.simulation.birdview import NOSE
from geoaim.synthetic import draw_place, make_place

SIDE, TEXTURE, AGENTS = 100.0, 1024, 20
COARSE, FINE = (377, 233), (6765, 4181)  # points in a pixel: for pictures, for gradients
SIZES = torch.tensor([[4.5, 1.9]]).expand(AGENTS, 2)
STEP = 0.05  # px: of the central differences


def picture_of_place() -> Float[Tensor, "3 h w"]:
    """A made junction."""
    place = draw_place(make_place(1), metres_per_pixel=0.1)
    image = cv2.resize(place, (TEXTURE, TEXTURE), interpolation=cv2.INTER_AREA)
    return torch.tensor(image).permute(2, 0, 1) / 255


def on_map(texture: Float[Tensor, "3 h w"]) -> Ground:
    """A ground of 200 m around the origin."""
    scale = TEXTURE / (2 * SIDE)
    matrix = torch.tensor([[scale, 0, TEXTURE / 2], [0, -scale, TEXTURE / 2]])
    return make_ground(texture, matrix)


def scene(views: int, seed: int, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Boxes]:
    """Cameras on the map, each with agents around it."""
    generator = torch.Generator().manual_seed(seed)
    random = torch.rand(views, AGENTS + 1, 6, generator=generator, dtype=torch.float64).to(dtype)
    cameras = torch.cat([random[:, 0, :2] * 60 - 30, random[:, 0, 2:3] * 6.28], 1)
    places = cameras[:, None, :2] + (random[:, 1:, :2] - 0.5) * 0.8 * SIDE
    poses = torch.cat([places, random[:, 1:, 2:3] * 6.28], 2)
    return cameras, Boxes(poses, SIZES.to(dtype), random[:, 1:, 3:], noses=1 - random[:, 1:, 3:])


def speed(ground: Ground, pixels: int, views: int, repeats: int) -> dict[str, Any]:
    """Forward and backward, against `grid_sample` alone of the same texture and grid."""
    view = View(pixels, pixels, SIDE / pixels)
    fitted = fit_ground(ground, view.resolution)
    cameras, boxes = scene(views, 1)
    texture = ground.image[None, :, 1:-1, 1:-1].contiguous()
    grid = _grid(view, cameras, ground).requires_grad_()
    weight = torch.rand(1, 3, views * pixels, pixels)
    own = weight.view(3, views, pixels, pixels).transpose(0, 1)
    given = [x.clone().requires_grad_() for x in (cameras, boxes.poses)]

    def forward() -> None:
        with torch.no_grad():
            render(view, cameras, fitted, [boxes])

    def sample() -> None:
        with torch.no_grad():
            F.grid_sample(texture, grid, align_corners=False)

    def both() -> None:
        picture = render(view, given[0], fitted, [replace(boxes, poses=given[1])])
        torch.autograd.grad((picture * own).sum(), given)

    def sample_both() -> None:
        torch.autograd.grad(
            (F.grid_sample(texture, grid, align_corners=False) * weight).sum(), grid
        )

    image = np.ascontiguousarray(ground.image[:, 1:-1, 1:-1].permute(1, 2, 0).numpy())
    ours, alone, ours_both, alone_both, opencv = medians(
        [
            forward,
            sample,
            both,
            sample_both,
            lambda: _by_opencv(view, cameras, ground, boxes, image),
        ],
        repeats,
    )
    return {
        "pixels": pixels,
        "views": views,
        "ms a view": 1e3 * ours / views,
        "times grid_sample": ours / alone,
        "forward + backward, ms": 1e3 * ours_both / views,
        "times grid_sample's": ours_both / alone_both,
        "times OpenCV (no gradient)": ours / opencv,
    }


def memory(pixels: int, views: int) -> float:
    """Megabytes a view that forward and backward add at most, in a process of its own."""
    code = f"from geoaim.bench.birdview import _added; print(_added({pixels}, {views}))"
    return float(subprocess.check_output([sys.executable, "-c", code])) / views


def _added(pixels: int, views: int) -> float:
    """Megabytes by which a batch raises the most memory that the process has held."""
    torch.set_num_threads(1)
    view = View(pixels, pixels, SIDE / pixels)
    ground = fit_ground(on_map(torch.rand(3, TEXTURE, TEXTURE)), view.resolution)

    def run(count: int) -> None:
        cameras, boxes = scene(count, 1)
        given = [x.clone().requires_grad_() for x in (cameras, boxes.poses)]
        picture = render(view, given[0], ground, [replace(boxes, poses=given[1])])
        torch.autograd.grad(picture.sum(), given)

    run(1)
    before = peak_megabytes()
    run(views)
    return peak_megabytes() - before


def picture_error(ground: Ground, pixels: int) -> dict[str, Any]:
    """Grey levels between a picture and the reference."""
    view = View(pixels, pixels, SIDE / pixels)
    fitted, apart = fit_ground(ground, view.resolution), []
    for seed in range(4):
        cameras, boxes = _apart(*scene(1, seed, torch.float64))
        wanted = supersampled(view, cameras, ground, boxes)
        apart.append((render(view, cameras, fitted, [boxes]) - wanted).abs() * 255)
    every = torch.cat(apart)
    return {"pixels": pixels, "mean": float(every.mean()), "largest": float(every.max())}


def gradient_errors(count: int) -> list[dict[str, Any]]:
    """Relative errors against the reference's central differences, scene by scene."""
    names = ("x", "y", "heading", "length", "width", "camera x", "camera y", "camera heading")
    rows = np.array([_gradient_error(seed) for seed in range(count)])
    return [
        {
            "gradient by": name,
            "median error, %": 100 * float(np.median(row)),
            "worst error, %": 100 * float(np.max(row)),
        }
        for name, row in zip(names, rows.T, strict=True)
    ]


def _gradient_error(seed: int) -> list[float]:
    """One agent on smooth ground: the error of each gradient, relative to the size of its kind.

    Kinds are place, heading and size of the agent, place and heading of the camera; the size is at
    least a twentieth of the largest gradient's.
    """
    generator = torch.Generator().manual_seed(seed)
    random = torch.rand(8, generator=generator, dtype=torch.float64)
    view = View(24, 24, 0.5)
    v, u = torch.meshgrid(torch.arange(80.0), torch.arange(80.0), indexing="ij")
    image = (0.5 + 0.4 * torch.sin(u / 7 + 6 * random[0]) * torch.cos(v / 9)).double()[None]
    ground = make_ground(image, torch.tensor([[2.0, 0, 40], [0, -2.0, 40]]).double())
    across = torch.linspace(-1, 1, 24, dtype=torch.float64)
    weight = (
        across[:, None] * torch.cos(3 * across + 6 * random[1]) + torch.sin(5 * across)[:, None]
    )
    pose = torch.stack([6 * random[2] - 3, 6 * random[3] - 3, 6.28 * random[4]])
    values = torch.cat([pose, SIZES[0].double(), random[5:8] * torch.tensor([2.0, 2.0, 6.28])])

    fitted = fit_ground(ground, view.resolution)

    def loss(values: Tensor, draw: Callable[..., Tensor]) -> Tensor:
        boxes = Boxes(values[None, None, :3], values[None, 3:5], torch.ones(1, 1).double())
        return (draw(view, values[None, 5:], ground, boxes)[0, 0] * weight).sum()

    exact = values.clone().requires_grad_()
    loss(exact, lambda v, c, _, b: render(v, c, fitted, [b])).backward()  # type: ignore[no-untyped-call]
    assert exact.grad is not None
    steps = (
        torch.tensor([1.0, 1, 0.2, 1, 1, 1, 1, 0.05], dtype=torch.float64) * STEP * view.resolution
    )
    found = exact.grad * steps

    finest = partial(supersampled, lattice=FINE)
    wanted = torch.stack(
        [(loss(values + m, finest) - loss(values - m, finest)) / 2 for m in torch.diag(steps)]
    )
    kinds = torch.tensor([0, 0, 1, 2, 2, 3, 3, 4])
    size = torch.zeros(5, dtype=torch.float64).index_add(0, kinds, wanted**2).sqrt()[kinds]
    least = wanted.abs().max() * 0.05
    return ((found - wanted).abs() / torch.maximum(size, least)).tolist()


def supersampled(
    view: View,
    cameras: Float[Tensor, "B 3"],
    ground: Ground,
    boxes: Boxes,
    lattice: tuple[int, int] = COARSE,
) -> Float[Tensor, "B C H W"]:
    """Every pixel the mean over the points of a lattice in it, each in a box or not.

    A Fibonacci lattice leaves no row or column of points along an edge, so that the share of a
    pixel in a box comes out several times closer than with as many points on a grid.
    """
    number = torch.arange(lattice[0]).to(cameras) / lattice[0]
    across = (number + 0.5 / lattice[0] - 0.5) * view.resolution
    forward = ((number * lattice[1] + 0.5 / lattice[0]) % 1 - 0.5) * view.resolution
    rows, columns = (torch.arange(n).to(cameras) - (n - 1) / 2 for n in (view.height, view.width))
    ahead, right = -rows[:, None] * view.resolution, columns * view.resolution
    pictures = []
    for b, (x, y, heading) in enumerate(cameras):
        c, s = heading.cos(), heading.sin()
        moved = torch.stack([x + forward * c + across * s, y + forward * s - across * c], 1)
        moved = F.pad(moved, (0, 1)) + F.pad(heading[None], (2, 0))
        picture = render(view, moved, ground)
        east = moved[:, 0, None, None] + ahead * c + right * s
        north = moved[:, 1, None, None] + ahead * s - right * c
        for a in range(boxes.poses.shape[1]):
            picture = _painted(picture, east, north, boxes, b, a)
        pictures.append(picture.mean(0))
    return torch.stack(pictures)


def _painted(
    picture: Tensor, east: Tensor, north: Tensor, boxes: Boxes, view: int, agent: int
) -> Tensor:
    """Points in a box in its colour, points in its triangle in that one's."""
    x, y, heading = boxes.poses[view, agent]
    length, width = boxes.sizes.expand(*boxes.poses.shape[:2], 2)[view, agent] / 2
    along = (east - x) * heading.cos() + (north - y) * heading.sin()
    aside = ((north - y) * heading.cos() - (east - x) * heading.sin()).abs()
    inside = (along.abs() < length) & (aside < width)
    tip = inside & (along > (1 - 2 * NOSE) * length)
    tip &= aside / width < (length - along) / (2 * NOSE * length)
    for where, colours in ((inside, boxes.colours), (tip, boxes.noses)):
        if colours is not None:
            colour = colours.expand(*boxes.poses.shape[:2], -1)[view, agent]
            picture = torch.where(where[:, None], colour[:, None, None], picture)
    return picture


def _apart(cameras: Tensor, boxes: Boxes) -> tuple[Tensor, Boxes]:
    """Without agents that would stand in others."""
    gaps = torch.cdist(boxes.poses[0, :, :2], boxes.poses[0, :, :2])
    keep = [a for a in range(AGENTS) if not (gaps[a, :a] < 6.5).any()]
    assert boxes.noses is not None
    some = replace(boxes, poses=boxes.poses[:, keep], sizes=boxes.sizes[keep])
    return cameras, replace(some, colours=boxes.colours[:, keep], noses=boxes.noses[:, keep])


def _grid(view: View, cameras: Tensor, ground: Ground) -> Tensor:
    """Where the pixels of all views lie in the texture, as `grid_sample` takes it."""
    corners = torch.tensor([[-1.0, 1.0]]) * view.width * view.resolution / 2
    c, s = cameras[:, 2].cos(), cameras[:, 2].sin()
    turn = torch.stack([torch.stack([s, -c], 1), torch.stack([-c, -s], 1)], 2) * corners[0, 1]
    matrix = ground.image_from_world - torch.tensor([0.0, 0, 1])  # without the ground's frame
    theta = torch.cat(
        [matrix[:, :2] @ turn, (cameras[:, :2] @ matrix[:, :2].t() + matrix[:, 2])[..., None]], 2
    )
    theta = theta * 2 / TEXTURE - torch.tensor([0.0, 0, 1])
    grid = F.affine_grid(theta, [len(cameras), 1, view.height, view.width], align_corners=False)
    return grid.view(1, -1, view.width, 2).contiguous()


def _by_opencv(
    view: View, cameras: Tensor, ground: Ground, boxes: Boxes, image: np.ndarray
) -> list[np.ndarray]:
    """What scripts do: a warp for each view and hard-edged polygons."""
    pictures = []
    half = np.array([view.width, view.height]) / 2
    sides = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    for camera, poses, colours in zip(
        cameras.numpy(), boxes.poses.numpy(), boxes.colours.numpy(), strict=True
    ):
        c, s = np.cos(camera[2]), np.sin(camera[2])
        turn = np.array([[s, -c], [-c, -s]]) / view.resolution
        view_from_world = np.eye(3)
        view_from_world[:2] = np.column_stack([turn, half - turn @ camera[:2]])
        image_from_world = np.eye(3)
        image_from_world[:2] = ground.image_from_world.numpy() - [0, 0, 1]
        matrix = to_opencv(view_from_world @ np.linalg.inv(image_from_world))
        picture = cv2.warpAffine(image, matrix[:2], (view.width, view.height))
        for (x, y, heading), colour in zip(poses, colours, strict=True):
            axis = np.array(
                [[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]]
            )
            corners = [x, y] + (sides * SIZES[0].numpy() / 2) @ axis
            ring = corners @ turn.T + view_from_world[:2, 2] - 0.5
            cv2.fillConvexPoly(picture, np.rint(ring).astype(np.int32), colour.tolist())
        pictures.append(picture)
    return pictures


def main(
    json: Annotated[Path | None, typer.Option(help="where to write the figures")] = None,
    repeats: Annotated[int, typer.Option(help="of each timing; the median counts")] = 7,
    scenes: Annotated[int, typer.Option(help="for the gradients")] = 200,
) -> None:
    """Measure speed, memory, pictures and gradients; print tables, and write JSON when asked."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    texture = picture_of_place()
    ground, exact = on_map(texture), on_map(texture.double())
    rows = [speed(ground, pixels, views, repeats) for pixels in (256, 64) for views in (1, 16, 64)]
    print(table(rows), flush=True)
    pictures = [picture_error(exact, pixels) for pixels in (256, 128)]
    gradients = gradient_errors(scenes)
    megabytes = memory(256, 64)
    print(table(pictures), table(gradients), f"{megabytes:.1f} MB a view", sep="\n\n")
    command = f"python -m geoaim.bench.birdview --scenes {scenes} --repeats {repeats}"
    more = {"pictures": pictures, "gradients": gradients, "megabytes_a_view": megabytes}
    save(rows, json, command=command, torch=torch.__version__, **more)


if __name__ == "__main__":
    typer.run(main)
