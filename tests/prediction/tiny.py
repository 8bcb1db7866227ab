"""A tiny model configuration, and small segments with known ground truth."""

import torch

from geoaim.prediction.config import Config
from geoaim.prediction.segments import PEDESTRIAN, VEHICLE, Segments
from geoaim.rendering.ground import make_ground
from geoaim.simulation.kinematics import bicycle
from geoaim.tracks.lights import GREEN

TINY = Config(
    "vehicle",
    "bicycle",
    dt=0.1,
    view_size=16,
    resolution=2.0,
    view_stride=3,
    hidden_size=16,
    feature_size=12,
)


def drive(steps=12, count=3, curve=0.05, dtype=torch.float32):
    """Cars on arcs, each with a pedestrian beside its path."""
    state = torch.zeros(count, 4, dtype=dtype)
    state[:, 3] = torch.linspace(4, 8, count)
    state[:, 0] = 3 * torch.arange(count)
    action = torch.tensor([0.5, curve], dtype=dtype).expand(count, 2)
    path = [state]
    for _ in range(steps - 1):
        path.append(bicycle.step(path[-1], action, torch.full((count,), 4.5, dtype=dtype), 0.1))
    cars = torch.stack(path, dim=1)
    pedestrians = torch.zeros_like(cars)
    pedestrians[..., 0] = 6.0
    pedestrians[..., 1] = 4.0 - 0.1 * torch.arange(steps, dtype=dtype)
    return Segments(
        states=torch.stack([cars, pedestrians], dim=1),
        present=torch.ones(count, 2, steps, dtype=torch.bool),
        sizes=torch.tensor([[4.5, 1.8], [0.5, 0.5]], dtype=dtype).expand(count, 2, 2),
        layers=torch.tensor([VEHICLE, PEDESTRIAN]).expand(count, 2),
        controlled=torch.tensor([True, False]).expand(count, 2),
        places=torch.zeros(count, dtype=torch.long),
        stop_lines=torch.tensor([[[9.0, -3.0], [9.0, 3.0]]], dtype=dtype).expand(count, 1, 2, 2),
        light_states=torch.full((count, steps, 1), GREEN),
        dt=0.1,
    )


def hill(dtype=torch.float32):
    """A ground that gets brighter to the north-east."""
    side = torch.linspace(0, 1, 40, dtype=dtype)
    image = (side[None, :] + 1 - side[:, None])[None].expand(3, 40, 40) / 2
    matrix = torch.tensor([[1.0, 0.0, 20.0], [0.0, -1.0, 20.0]], dtype=dtype)
    return make_ground(image, matrix)
