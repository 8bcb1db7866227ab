"""Renderers to compare with: OpenCV, plain torch with all boxes in all pixels, supersampling."""

import math
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from geoaim.base.geometry import to_opencv
from geoaim.rendering import Ground, OrientedBoxes, View, render
from geoaim.rendering.coverage import TRIANGLE_SHARE

LATTICE_POINTS, LATTICE_GENERATOR = 377, 233  # a Fibonacci lattice in each pixel
MAX_POINTS = 2_000_000  # points that are rendered at once
# A renderer takes a view, cameras (B, 3) and boxes (B, N), and returns pictures (B, 3, H, W).
Draw = Callable[[View, Tensor, OrientedBoxes], Tensor]


def crop_texture(ground: Ground) -> Float[Tensor, "1 3 h w"]:
    """Return the texture of a map, as one batch, without the border that `make_ground` adds."""
    return ground.image[None, :, 1:-1, 1:-1].contiguous()


def make_sampling_grid(view: View, cameras: Tensor, ground: Ground) -> Tensor:
    """Make the positions of the pixels of all views in the texture, for `grid_sample`.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3) x, y in metres and heading in radians.
        ground: the texture, whose border is left out.

    Returns:
        (1, B H, W, 2) from -1 to 1.
    """
    corners = torch.tensor([[-1.0, 1.0]]) * view.width * view.resolution / 2
    c, s = cameras[:, 2].cos(), cameras[:, 2].sin()
    turn = torch.stack([torch.stack([s, -c], 1), torch.stack([-c, -s], 1)], 2) * corners[0, 1]
    matrix = ground.image_from_world[0] - torch.tensor([0.0, 0, 1])  # without the border
    theta = torch.cat(
        [matrix[:, :2] @ turn, (cameras[:, :2] @ matrix[:, :2].t() + matrix[:, 2])[..., None]], 2
    )
    height, width = ground.image.shape[1] - 2, ground.image.shape[2] - 2
    theta = theta * 2 / torch.tensor([[width], [height]]) - torch.tensor([0.0, 0, 1])
    grid = F.affine_grid(theta, [len(cameras), 1, view.height, view.width], align_corners=False)
    return grid.view(1, -1, view.width, 2).contiguous()


def make_opencv_renderer(ground: Ground) -> Draw:
    """Make a renderer with a warp for each view and polygons with hard edges, as scripts do.

    It draws no triangles, has no gradient, and needs views as wide as high.
    """
    image = crop_texture(ground)[0].permute(1, 2, 0).contiguous().numpy()
    image_from_world = np.eye(3)
    image_from_world[:2] = ground.image_from_world[0].numpy() - [0, 0, 1]  # without the border
    sides = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) / 2

    def draw(view: View, cameras: Tensor, boxes: OrientedBoxes) -> Tensor:
        size = view.width, view.height
        pictures = np.empty((len(cameras), view.height, view.width, 3), image.dtype)
        poses, colours = boxes.poses.numpy(), boxes.colours.numpy()
        for picture, camera, own_poses, own_colours in zip(
            pictures, cameras.numpy(), poses, colours, strict=True
        ):
            c, s = np.cos(camera[2]), np.sin(camera[2])
            turn = np.array([[s, -c], [-c, -s]]) / view.resolution
            view_from_world = np.eye(3)
            view_from_world[:2] = np.column_stack([turn, np.divide(size, 2) - turn @ camera[:2]])
            matrix = to_opencv(view_from_world @ np.linalg.inv(image_from_world))
            cv2.warpAffine(image, matrix[:2], size, dst=picture)
            for (x, y, heading), box_size, colour in zip(
                own_poses, boxes.sizes.numpy(), own_colours, strict=True
            ):
                c, s = np.cos(heading), np.sin(heading)
                corners = [x, y] + (sides * box_size) @ np.array([[c, s], [-s, c]])
                ring = corners @ turn.T + view_from_world[:2, 2] - 0.5
                cv2.fillConvexPoly(picture, np.rint(ring).astype(np.int32), colour.tolist())
        return torch.from_numpy(pictures).permute(0, 3, 1, 2)

    return draw


def make_distance_renderer(ground: Ground) -> Draw:
    """Make a renderer with every box's distance in every pixel, edges one pixel soft.

    It draws no triangles.
    """
    texture = crop_texture(ground)

    def draw(view: View, cameras: Tensor, boxes: OrientedBoxes) -> Tensor:
        grid = make_sampling_grid(view, cameras, ground)
        pixels = F.grid_sample(texture, grid, align_corners=False)
        picture = pixels.view(3, len(cameras), view.height, view.width).transpose(0, 1)
        rows, columns = (torch.arange(n) - (n - 1) / 2 for n in (view.height, view.width))
        offset = boxes.poses[..., :2] - cameras[:, None, :2]
        c, s = cameras[:, 2:].cos(), cameras[:, 2:].sin()
        right = (offset[..., 0] * s - offset[..., 1] * c) / view.resolution
        forward = (offset[..., 0] * c + offset[..., 1] * s) / view.resolution
        turn = boxes.poses[..., 2] - cameras[:, 2:]
        for a in range(boxes.poses.shape[1]):
            x = columns - right[:, a, None, None]
            y = -rows[:, None] - forward[:, a, None, None]
            cosine, sine = turn[:, a, None, None].cos(), turn[:, a, None, None].sin()
            length, width = boxes.sizes[a] / 2 / view.resolution
            along, aside = y * cosine - x * sine, y * sine + x * cosine
            inside = torch.minimum(length - along.abs(), width - aside.abs())
            alpha = (inside + 0.5).clamp(0, 1)[:, None]
            picture = picture + alpha * (boxes.colours[:, a, :, None, None] - picture)
        return picture

    return draw


def supersample(
    view: View, cameras: Float[Tensor, "B 3"], ground: Ground, boxes: OrientedBoxes
) -> Float[Tensor, "B C H W"]:
    """Render pictures whose pixels are means over many points, each in a box or not.

    The points are a Fibonacci lattice, which has no row or column of points along an edge.
    The covered share of a pixel comes out several times closer than by a square grid.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3) x, y, heading.
        ground: the map.
        boxes: boxes in paint order.

    Returns:
        (B, C, H, W).
    """
    rows, columns = (torch.arange(n).to(cameras) - (n - 1) / 2 for n in (view.height, view.width))
    ahead, right = -rows[:, None] * view.resolution, columns * view.resolution
    points, pictures = torch.arange(LATTICE_POINTS).to(cameras), []
    for b, (x, y, heading) in enumerate(cameras):
        c, s = heading.cos(), heading.sin()
        total = torch.zeros(len(ground.image), view.height, view.width).to(cameras)
        for some in torch.split(points, max(1, MAX_POINTS // total[0].numel())):
            across = ((some + 0.5) / LATTICE_POINTS - 0.5) * view.resolution
            forward = (
                (some * LATTICE_GENERATOR + 0.5) / LATTICE_POINTS % 1 - 0.5
            ) * view.resolution
            shifted = torch.stack([x + forward * c + across * s, y + forward * s - across * c], 1)
            shifted = F.pad(shifted, (0, 1)) + F.pad(heading[None], (2, 0))
            unfiltered = replace(ground, finest=math.inf)  # without its warning
            picture = render(view, shifted, unfiltered)
            east = shifted[:, 0, None, None] + ahead * c + right * s
            north = shifted[:, 1, None, None] + ahead * s - right * c
            for a in range(boxes.poses.shape[1]):
                picture = _paint_box(picture, (east, north), boxes, b, a)
            total += picture.sum(0)
        pictures.append(total / LATTICE_POINTS)
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
