"""Bird's-eye pictures of a map as models see it, from tensors to tensors, and a simulator.

view = View(256, 256, 0.4)
pictures = render(view, cameras, prefilter_ground(ground, view.resolution), [boxes])
"""

from geoaim.simulation.atlas import stack_grounds
from geoaim.simulation.birdview import render, render_layers
from geoaim.simulation.boxes import OrientedBoxes
from geoaim.simulation.collation import collate_boxes, collate_scenarios
from geoaim.simulation.corners import ground_from_corners, read_ground
from geoaim.simulation.ground import Ground, View, make_ground
from geoaim.simulation.layers import (
    make_agent_boxes,
    make_layers,
    make_light_boxes,
    make_trail_boxes,
)
from geoaim.simulation.lines import make_line_boxes, make_path_boxes, make_stop_line_boxes
from geoaim.simulation.module import Renderer
from geoaim.simulation.prefiltering import prefilter_ground
from geoaim.simulation.sampling import render_coverage
from geoaim.simulation.scene import Scene, make_scene

__all__ = [
    "Ground",
    "OrientedBoxes",
    "Renderer",
    "Scene",
    "View",
    "collate_boxes",
    "collate_scenarios",
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
