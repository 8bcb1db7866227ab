"""Pictures of a map as models see it, from tensors to tensors, and a simulator around them.

view = View(256, 256, 0.4)
pictures = render(view, cameras, fit_ground(ground, view.resolution), [boxes])
"""

from geoaim.simulation.birdview import Boxes, render, render_layers
from geoaim.simulation.ground import Ground, View, fit_ground, ground_share, make_ground
from geoaim.simulation.layers import agents_at, layers_at, lights_at, trails_at
from geoaim.simulation.lines import light_boxes, line_boxes, path_boxes
from geoaim.simulation.scene import Scene, make_scene

__all__ = [
    "Boxes",
    "Ground",
    "Scene",
    "View",
    "agents_at",
    "fit_ground",
    "ground_share",
    "layers_at",
    "light_boxes",
    "lights_at",
    "line_boxes",
    "make_ground",
    "make_scene",
    "path_boxes",
    "render",
    "render_layers",
    "trails_at",
]
