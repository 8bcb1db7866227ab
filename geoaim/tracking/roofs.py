"""Roofs: boxes of agents that stand up from the ground, seen from a known height."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.base.geometry import transform_points
from geoaim.mapping.video.telemetry import Telemetry
from geoaim.tracking.ground_detections import GroundDetections
from geoaim.tracking.sizes import get_typical_size

# by type: heights of agents, m, and lengths of their roofs as shares of their own; others are taken
# for cars, or for lorries if they are as long
ROOFS = {
    "car": (1.5, 0.55),
    "van": (2.0, 0.8),
    "truck": (3.3, 1.0),
    "bus": (3.1, 1.0),
    "motorcycle": (1.5, 0.5),
    "cyclist": (1.7, 0.5),
    "pedestrian": (1.7, 1.0),
}
OTHER, LONG, LONG_M = "car", "truck", 8.0
ROOF_WIDTH = 0.85  # share of an agent's width
LEAN_SHARE = 0.06  # of how far a roof leans, by which it may be off, since heights differ


def describe_roofs(flying_height: float | None, telemetry: Telemetry | None) -> str:
    """Describe whether roofs are corrected, and the height that the telemetry states.

    >>> describe_roofs(100.0, None)
    'corrected from 100 m above the ground'
    """
    if flying_height is not None:
        return f"corrected from {flying_height:g} m above the ground"
    stated = np.empty(0) if telemetry is None else telemetry.height[telemetry.height > 0]
    hint = f"; {np.median(stated):.0f} m above take-off by its telemetry" if len(stated) else ""
    return (
        "not corrected: they lean outwards by their height over the camera's, which the position "
        f"noise leaves out (--flying-height{hint})"
    )


def correct_roofs(
    detections: GroundDetections,
    world_from_frame: Float[Array, "T 3 3"],
    size: tuple[int, int],
    flying_height: float,
) -> GroundDetections:
    """Correct boxes on the ground for roofs, which lean away from below the camera.

    The camera looks straight down from above the middle of the frame, `flying_height` metres above
    the ground. A box holds an agent's base and its roof, which is smaller, and leans outwards by
    its height over that of the camera above it. Where the roof ends further out than the base, the
    box ends with it, and goes back. The roof may be as large as the base, as of a box, or as small
    as is typical of the type; the correction is that of the middle between both, and the detections
    state how far off it may be.
    """
    below = _find_below(detections.step, world_from_frame, size)
    known = np.where(np.isin(detections.types, list(ROOFS)), detections.types, OTHER)
    known[(detections.types == "") & (detections.extent.max(axis=1) > LONG_M)] = LONG
    height, share = np.array([ROOFS[kind] for kind in known]).T
    size_by_type = np.array([get_typical_size(kind) for kind in known])
    lean = (height / np.maximum(flying_height - height, height))[:, None]
    inset = _find_insets(detections.extent, size_by_type, share)
    right = np.column_stack([np.cos(detections.axis), np.sin(detections.axis)])
    sides = np.stack([right, detections.down], axis=1)
    offset = ((detections.position - below)[:, None] * sides).sum(axis=2)
    low, high = offset - detections.extent / 2, offset + detections.extent / 2
    shifts, extents = [], []
    for part in (0.0, 1.0):  # a roof as large as the agent, and the typical one
        base_low = np.where(low < 0, np.maximum(low, low / (1 + lean) - part * inset), low)
        base_high = np.where(high > 0, np.minimum(high, high / (1 + lean) + part * inset), high)
        shifts.append((base_low + base_high) / 2 - offset)
        extents.append(base_high - base_low)
    shift, extent = np.mean(shifts, axis=0), np.mean(extents, axis=0)
    moved = detections.position + (shift[..., None] * sides).sum(axis=1)
    unsure = np.hypot(*(shifts[1] - shifts[0]).T) / np.sqrt(12)  # of an even distribution
    sigma = np.hypot(unsure, LEAN_SHARE * lean[:, 0] * np.hypot(*offset.T) / 2)
    return replace(detections, position=moved, extent=extent, roof_sigma=sigma)


def _find_insets(
    extent: Float[Array, "M 2"], size: Float[Array, "M 2"], share: Float[Array, "M"]
) -> Float[Array, "M 2"]:
    """Find by how much roofs end within their boxes, m, by how agents are turned in these."""
    length, width = size.T
    # sides are l cos + w sin and l sin + w cos, whose difference tells the turn
    turn = np.clip((extent[:, 0] - extent[:, 1]) / np.maximum(length - width, 0.1), -1, 1)
    cosine = (turn + np.sqrt(2 - turn**2)) / 2
    sine = cosine - turn
    along, across = (1 - share) * length / 2, (1 - ROOF_WIDTH) * width / 2
    return np.column_stack([along * cosine + across * sine, along * sine + across * cosine])


def _find_below(
    step: Int[Array, "M"], world_from_frame: Float[Array, "T 3 3"], size: tuple[int, int]
) -> Float[Array, "M 2"]:
    """Find what lies below the camera: the middle of each detection's frame, m."""
    middle = np.array([[[size[1] / 2, size[0] / 2]]])
    points = transform_points(world_from_frame, np.tile(middle, (len(world_from_frame), 1, 1)))
    return np.asarray(points[step, 0])
