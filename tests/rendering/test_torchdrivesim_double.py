"""The renderer for torchdrivesim 0.2.3, by a double made from its published signatures alone."""

import importlib
import sys
from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import ModuleType
from typing import NamedTuple

import torch

from geoaim.rendering import make_ground


class Resolution(NamedTuple):
    """Height and width of a picture."""

    height: int
    width: int


@dataclass
class RendererConfig:
    """The options that both versions have."""

    render_agent_direction: bool = True
    left_handed_coordinates: bool = False
    highlight_ego_vehicle: bool = False


LEVELS = {"direction": 2, "ego": 3, "vehicle": 4, "pedestrian": 6, "goal_waypoint": 8}
COLOURS = {name: (30 * k, 255 - 30 * k, 10 * k) for k, name in enumerate(LEVELS)}
SMALL = Resolution(64, 64)


class BirdviewRenderer(ABC):
    """`BirdviewRenderer` of 0.2.3."""

    def __init__(
        self,
        cfg,
        device=None,
        batch_size=None,
        static_mesh=None,
        world_center=None,
        color_map=None,
        rendering_levels=None,
        res=SMALL,
        fov=35,
    ):
        if static_mesh is None and batch_size is None:
            raise ValueError("a batch size is needed")
        self.cfg, self.device, self.res, self.scale = cfg, device, res, 2.0 / fov
        self.color_map, self.rendering_levels = color_map or COLOURS, rendering_levels or LEVELS
        self.world_center = torch.zeros(batch_size, 2) if world_center is None else world_center

    @abstractmethod
    def render_frame(
        self,
        agent_state,
        agent_attributes,
        camera_xy=None,
        camera_sc=None,
        rendering_mask=None,
        res=None,
        traffic_controls=None,
        fov=None,
        waypoints=None,
        waypoints_rendering_mask=None,
    ):
        """Render a picture of each element of a batch."""


def test_views_follow_all_agents_and_batches_are_expanded(monkeypatch):
    for name, contents in {
        "torchdrivesim": {},
        "torchdrivesim.rendering": {},
        "torchdrivesim.rendering.base": {
            "BirdviewRenderer": BirdviewRenderer,
            "RendererConfig": RendererConfig,
        },
        "torchdrivesim.utils": {"Resolution": Resolution},
    }.items():
        module = ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
    ours = "geoaim.rendering.torchdrivesim"
    monkeypatch.delitem(sys.modules, ours, raising=False)
    image = torch.rand(3, 60, 60, generator=torch.Generator().manual_seed(0))
    ground = make_ground(image, torch.tensor([[1.0, 0, 30], [0, -1.0, 30]]))
    renderer = importlib.import_module(ours).ImageMapRenderer(ground, batch_size=1, fov=40.0)
    monkeypatch.delitem(sys.modules, ours)
    poses = torch.tensor([[[2.0, 1.0, 0.4, 0], [-6.0, 3.0, 2.0, 0], [2.5, 1.5, 1.0, 0]]])
    sizes = torch.tensor([[[4.5, 1.9], [8.0, 2.5], [2.0, 2.0]]])
    views = renderer.render_frame({"vehicle": poses}, {"vehicle": sizes})
    assert views.shape == (1, 3, 3, 64, 64)
    assert renderer.expand(2).select_batch_elements(torch.tensor([1])).world_center.shape == (1, 2)
