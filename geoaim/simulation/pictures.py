"""Pictures that people look at: what an agent has around it, as a film or a single picture."""

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

from geoaim.encode import write_video
from geoaim.files import atomic_write
from geoaim.simulation.birdview import render
from geoaim.simulation.ground import View, fit_ground
from geoaim.simulation.layers import agents_at, lights_at, trails_at
from geoaim.simulation.scene import Scene

ENDINGS = (".mp4", ".gif", ".png")
BATCH = 16  # pictures that are rendered at once


def film_agent(
    scene: Scene, agent: int, view: View, steps: Int[Tensor, "S"], *, trail: float = 0.0
) -> Iterator[UInt8[Array, "H W 3"]]:
    """What an agent has around it at some steps at which it is there, for people's eyes.

    Trails show where agents were for so many seconds.
    """
    ground = fit_ground(scene.ground, view.resolution)
    for some in torch.split(steps, BATCH):
        layers = [lights_at(scene, some), agents_at(scene, some, torch.full_like(some, agent))]
        if trail > 0:
            layers.insert(1, trails_at(scene, some, seconds=trail))
        with torch.no_grad():
            pictures = render(view, scene.poses[agent, some], ground, layers)
        yield from pixels_of(pictures)


def pixels_of(pictures: Float[Tensor, "B 3 H W"]) -> UInt8[Array, "B H W 3"]:
    """Rendered pictures as images are kept."""
    pixels = (pictures.clamp(0, 1) * 255).round().to(torch.uint8)
    return np.ascontiguousarray(pixels.permute(0, 2, 3, 1).cpu().numpy())


def write_pictures(
    pictures: Iterable[UInt8[Array, "H W 3"]], path: str | os.PathLike[str], *, rate: float
) -> None:
    """Write .mp4 (even sides), .gif or .png (the first picture), so many pictures a second.

    Raises:
        ValueError: the name ends otherwise, or there are no pictures.
    """
    path, every = Path(path), iter(pictures)
    if path.suffix.lower() not in ENDINGS:
        raise ValueError(f"{path}: the name must end in {', '.join(ENDINGS)}")
    first = next(every, None)
    if first is None:
        raise ValueError(f"no pictures to write to {path}")
    if path.suffix.lower() == ".mp4":
        write_video(chain([first], every), path, frame_rate=rate)
        return
    with atomic_write(path) as temporary:
        if path.suffix.lower() == ".gif":
            rest = [Image.fromarray(picture) for picture in every]
            start = Image.fromarray(first)
            start.save(temporary, save_all=True, append_images=rest, duration=1000 / rate, loop=0)
        else:
            Image.fromarray(first).save(temporary)
