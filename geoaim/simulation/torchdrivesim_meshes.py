"""Image maps for torchdrivesim after 0.2.3, whose renderers are given one mesh of everything.

Written for its main branch of February 2026; `geoaim.simulation.torchdrivesim` chooses it.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torchdrivesim.rendering.base import BirdviewRenderer, RendererConfig
from torchdrivesim.utils import Resolution

from geoaim.simulation.birdview import render
from geoaim.simulation.ground import Ground, View
from geoaim.simulation.prefiltering import prefilter_ground
from geoaim.simulation.triangles import paint_triangles


class MeshRenderer(BirdviewRenderer):  # type: ignore[misc]
    """A torchdrivesim renderer that paints meshes over an image map.

    The simulator's background mesh is painted too: give it one without the road, which the image
    shows. Pictures are differentiable with respect to cameras, vertices and colours.

    Args:
        ground: the map, in the simulator's coordinates, with three channels from 0 to 1.
        cfg: torchdrivesim's own configuration, of which left_handed_coordinates is used.
        base: arguments of `BirdviewRenderer`: res, fov, color_map, rendering_levels. batch_size,
            device, static_mesh and world_center of version 0.2.3 are not needed any more and have
            no effect.
    """

    def __init__(self, ground: Ground, cfg: RendererConfig | None = None, **base: Any) -> None:
        for name in ("batch_size", "device", "static_mesh", "world_center"):
            base.pop(name, None)
        super().__init__(cfg or RendererConfig(), **base)
        self.ground = ground
        self.prefiltered: dict[float, Ground] = {}  # keys: the resolutions

    def copy(self) -> "MeshRenderer":
        """Copy the renderer; the map is shared."""
        return MeshRenderer(
            self.ground,
            self.cfg,
            color_map=dict(self.color_map),
            rendering_levels=dict(self.rendering_levels),
            res=self.res,
            fov=2.0 / self.scale,
        )

    def render_rgb_mesh(self, mesh: Any, res: Resolution, cameras: Any) -> Float[Tensor, "V H W 3"]:
        """Paint a mesh over the map.

        Args:
            mesh: torchdrivesim's `RGBMesh` of V views: verts (V, n, 3) x, y and level, faces
                (V, F, 3), attrs (V, n, 3) colours from 0 to 1.
            res: height and width of a view, pixels.
            cameras: V cameras: xy (V, 2), sc (V, 2) sine and cosine of the headings, scale.

        Returns:
            (V, H, W, 3) colours from 0 to 255.
        """
        view = View(res.height, res.width, 2.0 / cameras.scale / min(res.height, res.width))
        if view.resolution not in self.prefiltered or self.ground.image.requires_grad:
            self.prefiltered = {view.resolution: prefilter_ground(self.ground, view.resolution)}
        heading = torch.atan2(cameras.sc[..., 0], cameras.sc[..., 1])
        poses = torch.cat([cameras.xy, heading[..., None]], dim=-1)
        pictures = render(view, poses, self.prefiltered[view.resolution])
        scene = torch.arange(len(mesh.faces), device=mesh.faces.device)[:, None]
        verts, attrs = mesh.verts[scene, mesh.faces[..., 0]], mesh.attrs[scene, mesh.faces[..., 0]]
        corners = mesh.verts[scene[..., None], mesh.faces][..., :2]  # (V, F, 3, 2)
        if mesh.faces.shape[1]:
            pictures = paint_triangles(view, poses, pictures, corners, attrs, verts[..., 2])
        pictures = pictures.flip(-1) if self.cfg.left_handed_coordinates else pictures
        return 255 * pictures.permute(0, 2, 3, 1)
