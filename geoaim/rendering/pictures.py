"""Videos and pictures of an agent's surroundings, for people to look at."""

import os
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray as Array
from PIL import Image
from torch import Tensor

from geoaim.aim.aim import AIM
from geoaim.base.encode import write_video
from geoaim.base.files import atomic_write
from geoaim.rendering.birdview import render
from geoaim.rendering.ground import View
from geoaim.rendering.layers import make_agent_boxes, make_light_boxes, make_trail_boxes
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene

SUFFIXES = (".mp4", ".gif", ".png")
BATCH_SIZE = 16  # pictures that are rendered at once
FILM_HEIGHT_PX, FILM_TRAIL_S = 720, 1.0  # of the film of a whole map


def render_agent_video(
    scene: Scene, agent: int, view: View, steps: Int[Tensor, "S"], *, trail: float = 0.0
) -> Iterator[UInt8[Array, "H W 3"]]:
    """Render the view of an agent, heading up: the map, lights and all agents.

    Args:
        scene: the scene, with its map and lights.
        agent: row of the agent in the centre.
        view: size and resolution of the pictures.
        steps: (S,) index of each step to render, at which the agent is present.
        trail: duration of the agents' trails, seconds; 0: none.

    Yields:
        (H, W, 3) an RGB picture of each step.
    """
    ground = prefilter_ground(scene.ground, view.resolution)
    for batch in torch.split(steps, BATCH_SIZE):
        ego = torch.full_like(batch, agent)
        layers = [make_light_boxes(scene, batch), make_agent_boxes(scene, batch, ego)]
        if trail > 0:
            layers.insert(1, make_trail_boxes(scene, batch, duration=trail))
        with torch.no_grad():
            pictures = render(view, scene.poses[agent, batch], ground, layers)
        yield from convert_to_uint8(pictures)


def render_map_video(scene: Scene, aim: AIM) -> Iterator[UInt8[Array, "H W 3"]]:
    """Render the whole map, turned as its image is, with all agents and their trails at each step.

    Args:
        scene: the scene, of this map.
        aim: the map.

    Yields:
        (H, W, 3) an RGB picture of each step, with even sides, the smaller one of `FILM_HEIGHT_PX`.
    """
    (left, top), right, _, bottom = aim.corners
    across, down = right - (left, top), (left, top) - bottom
    extent = np.hypot(*across), np.hypot(*down)
    resolution = float(min(extent)) / FILM_HEIGHT_PX
    sides = [2 * max(1, round(side / resolution / 2)) for side in extent]
    view = View(sides[1], sides[0], resolution)
    middle = aim.corners.mean(axis=0)
    camera = torch.tensor([*middle, np.arctan2(down[1], down[0])], dtype=scene.poses.dtype)
    ground = prefilter_ground(scene.ground, resolution)
    for steps in torch.split(torch.arange(len(scene.times)), BATCH_SIZE):
        trails = make_trail_boxes(scene, steps, duration=FILM_TRAIL_S)
        layers = [make_light_boxes(scene, steps), trails, make_agent_boxes(scene, steps)]
        with torch.no_grad():
            pictures = render(view, camera.expand(len(steps), 3), ground, layers)
        yield from convert_to_uint8(pictures)


def convert_to_uint8(pictures: Float[Tensor, "B 3 H W"]) -> UInt8[Array, "B H W 3"]:
    """Convert rendered pictures, 0 to 1, to 8-bit images."""
    pixels = (pictures.clamp(0, 1).mul_(255)).round_().to(torch.uint8)
    return np.ascontiguousarray(pixels.permute(0, 2, 3, 1).cpu().numpy())


def write_pictures(
    pictures: Iterable[UInt8[Array, "H W 3"]], path: str | os.PathLike[str], *, frame_rate: float
) -> None:
    """Write a video, an animation, or a single picture.

    Args:
        pictures: (H, W, 3) RGB each; with even sides for .mp4.
        path: .mp4, .gif or .png, which holds the first picture.
        frame_rate: pictures per second; without effect on a .png.

    Raises:
        ValueError: the path has another suffix, or there are no pictures.
    """
    path, rest = Path(path), iter(pictures)
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(f"{path}: the name must end in {', '.join(SUFFIXES)}")
    first = next(rest, None)
    if first is None:
        raise ValueError(f"no pictures to write to {path}")
    if path.suffix.lower() == ".mp4":
        write_video(chain([first], rest), path, frame_rate=frame_rate)
        return
    with atomic_write(path) as temporary:
        image = Image.fromarray(first)
        if path.suffix.lower() == ".gif":
            more = (Image.fromarray(picture) for picture in rest)  # written as they are made
            duration = 1000 / frame_rate
            image.save(temporary, save_all=True, append_images=more, duration=duration, loop=0)
        else:
            image.save(temporary)
