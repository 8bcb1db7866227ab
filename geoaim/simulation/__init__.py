"""A simulator of traffic, from tensors to tensors; and the names of `geoaim.rendering`.

view = View(256, 256, 0.4)
pictures = render(view, cameras, prefilter_ground(ground, view.resolution), [boxes])
"""

from geoaim import rendering
from geoaim.rendering import *  # noqa: F403
from geoaim.simulation.simulator import collate_scenarios

__all__ = ["collate_scenarios"]
__all__ += rendering.__all__
