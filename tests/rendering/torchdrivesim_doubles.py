"""Doubles of torchdrivesim's renderer interface, made from its published signatures alone."""

import sys
from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import ModuleType
from typing import NamedTuple

import torch


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


class Renderer023(ABC):
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


class Cameras(NamedTuple):
    """What renderers of the next version are given."""

    xy: torch.Tensor
    sc: torch.Tensor
    scale: float


class Mesh(NamedTuple):
    """`RGBMesh`: vertices with a level, faces, colours of the vertices."""

    verts: torch.Tensor
    faces: torch.Tensor
    attrs: torch.Tensor


class RendererNext:
    """`BirdviewRenderer` of the main branch of February 2026."""

    def __init__(self, cfg, color_map=None, rendering_levels=None, res=SMALL, fov=35):
        self.cfg, self.res, self.scale = cfg, res, 2.0 / fov
        self.color_map, self.rendering_levels = color_map or COLOURS, rendering_levels or LEVELS

    def render_frame(self, rgb_mesh, camera_xy, camera_sc, res=None, fov=None):
        """Views of all cameras, (B Nc, C, H, W), by `render_rgb_mesh`."""
        scale = self.scale if fov is None else 2.0 / fov
        cameras = Cameras(camera_xy.reshape(-1, 2), camera_sc.reshape(-1, 2), scale)
        return self.render_rgb_mesh(rgb_mesh, res or self.res, cameras).permute(0, 3, 1, 2)


def install(monkeypatch, renderer):
    """Let `import torchdrivesim` find a double, and forget geoaim's modules that imported it."""
    for name in list(sys.modules):
        if name.split(".")[0] == "torchdrivesim" or name.startswith(
            "geoaim.rendering.torchdrivesim"
        ):
            monkeypatch.delitem(sys.modules, name)
    modules = {
        "torchdrivesim": {},
        "torchdrivesim.rendering": {},
        "torchdrivesim.rendering.base": {
            "BirdviewRenderer": renderer,
            "RendererConfig": RendererConfig,
        },
        "torchdrivesim.utils": {"Resolution": Resolution},
    }
    for name, contents in modules.items():
        module = ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
