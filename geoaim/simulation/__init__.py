"""Pictures of a map as models see it, from tensors to tensors; by and by a simulator around them.

view = View(256, 256, 0.4)
pictures = render(view, cameras, fit_ground(ground, view.resolution), [boxes])
"""

from geoaim.simulation.birdview import (
    Boxes,
    Ground,
    View,
    fit_ground,
    ground_share,
    make_ground,
    render,
)

__all__ = ["Boxes", "Ground", "View", "fit_ground", "ground_share", "make_ground", "render"]
