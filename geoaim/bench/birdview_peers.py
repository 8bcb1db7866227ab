"""Renderers to compare with: OpenCV, and plain torch with every box in every pixel."""

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from geoaim.geometry import to_opencv
from geoaim.simulation import Ground, OrientedBoxes, View


def make_sampling_grid(view: View, cameras: Tensor, ground: Ground) -> Tensor:
    """Make the positions of the pixels of all views in the texture, for `grid_sample`.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3) x, y, heading.
        ground: the texture, whose border is left out.

    Returns:
        (1, B H, W, 2) from -1 to 1.
    """
    corners = torch.tensor([[-1.0, 1.0]]) * view.width * view.resolution / 2
    c, s = cameras[:, 2].cos(), cameras[:, 2].sin()
    turn = torch.stack([torch.stack([s, -c], 1), torch.stack([-c, -s], 1)], 2) * corners[0, 1]
    matrix = ground.image_from_world - torch.tensor([0.0, 0, 1])  # without the border
    theta = torch.cat(
        [matrix[:, :2] @ turn, (cameras[:, :2] @ matrix[:, :2].t() + matrix[:, 2])[..., None]], 2
    )
    height, width = ground.image.shape[1] - 2, ground.image.shape[2] - 2
    theta = theta * 2 / torch.tensor([[width], [height]]) - torch.tensor([0.0, 0, 1])
    grid = F.affine_grid(theta, [len(cameras), 1, view.height, view.width], align_corners=False)
    return grid.view(1, -1, view.width, 2).contiguous()


def render_with_opencv(
    view: View, cameras: Tensor, ground: Ground, boxes: OrientedBoxes, image: np.ndarray
) -> list[np.ndarray]:
    """Render by a warp for each view and polygons with hard edges, as scripts do.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3) x, y, heading.
        ground: where the texture lies.
        boxes: to draw, without triangles.
        image: (h, w, 3) the texture.

    Returns:
        B pictures (H, W, 3).
    """
    pictures, sizes = [], boxes.sizes.numpy()
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
        for (x, y, heading), size, colour in zip(poses, sizes, colours, strict=True):
            axis = np.array(
                [[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]]
            )
            corners = [x, y] + (sides * size / 2) @ axis
            ring = corners @ turn.T + view_from_world[:2, 2] - 0.5
            cv2.fillConvexPoly(picture, np.rint(ring).astype(np.int32), colour.tolist())
        pictures.append(picture)
    return pictures


def render_by_distances(
    view: View, cameras: Tensor, image: Float[Tensor, "1 3 h w"], grid: Tensor, boxes: OrientedBoxes
) -> Float[Tensor, "B 3 H W"]:
    """Render by every box's distance in every pixel, with edges one pixel soft.

    Args:
        view: size and resolution of the pictures.
        cameras: (B, 3) x, y, heading.
        image: the texture.
        grid: of `make_sampling_grid`.
        boxes: to draw, without triangles.

    Returns:
        (B, 3, H, W).
    """
    count = len(cameras)
    pixels = F.grid_sample(image, grid, align_corners=False)
    picture = pixels.view(3, count, view.height, view.width).transpose(0, 1)
    rows, columns = (torch.arange(n).to(cameras) - (n - 1) / 2 for n in (view.height, view.width))
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
