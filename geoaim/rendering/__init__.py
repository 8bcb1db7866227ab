"""Bird's-eye pictures of a map as models see it, from tensors to tensors.

view = View(256, 256, 0.4)
pictures = render(view, cameras, prefilter_ground(ground, view.resolution), [boxes])
"""

from geoaim.rendering.atlas import stack_grounds
from geoaim.rendering.birdview import Renderer, render, render_layers
from geoaim.rendering.boxes import OrientedBoxes, collate_boxes
from geoaim.rendering.corners import ground_from_corners, read_ground
from geoaim.rendering.drawing import render_coverage
from geoaim.rendering.ground import Ground, View, make_ground
from geoaim.rendering.layers import (
    make_agent_boxes,
    make_layers,
    make_light_boxes,
    make_trail_boxes,
)
from geoaim.rendering.lines import make_line_boxes, make_path_boxes, make_stop_line_boxes
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene, make_scene

__all__ = [
    "Ground",
    "OrientedBoxes",
    "Renderer",
    "Scene",
    "View",
    "collate_boxes",
    "ground_from_corners",
    "make_agent_boxes",
    "make_ground",
    "make_layers",
    "make_light_boxes",
    "make_line_boxes",
    "make_path_boxes",
    "make_scene",
    "make_stop_line_boxes",
    "make_trail_boxes",
    "prefilter_ground",
    "read_ground",
    "render",
    "render_coverage",
    "render_layers",
    "stack_grounds",
]
