"""Detections on the ground: boxes of all frames as positions and extents in the world."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray as Array

from geoaim.base.geometry import transform_points
from geoaim.mapping.video.detections import DetectedBoxes

BORDER_PX = 8.0  # a box that ends this near to the frame's border may be cut off by it
FRAMES_AT_ONCE = 1000
MID_SIDES = np.array([[0.0, 0.5], [1.0, 0.5], [0.5, 0.0], [0.5, 1.0]])  # of a box: ends of its axes
# of the corners of a box, those at the start and the end of each side
END_CORNERS = np.array([[[0, 3], [1, 2]], [[0, 1], [2, 3]]])


@dataclass(frozen=True, eq=False)
class GroundDetections:
    """Detections of all frames in the world; M detections, in order of time."""

    step: Int[Array, " M"]  # number of the frame
    position: Float[Array, "M 2"]  # middle of the box, m
    axis: Float[Array, " M"]  # direction of the box's first side on the ground, rad
    down: Float[Array, "M 2"]  # unit vector of its second side on the ground
    extent: Float[Array, "M 2"]  # along that side and across it, m
    oriented: Bool[Array, " M"]  # whether the box is turned with the agent, and not with the frame
    # whether the frame's border may cut off the box: at the start and the end of each side
    cut: Bool[Array, "M 2 2"]
    resolution: Float[Array, " M"]  # metres per pixel there
    view: Float[Array, " M"]  # ground that the whole frame shows at that resolution, m²
    score: Float[Array, " M"]  # confidence of the detector, 0 to 1; NaN if unknown
    types: Shaped[Array, " M"]  # agent types, "" if unknown
    roof_sigma: Float[Array, " M"]  # how far off the correction of a roof may be, m; 0 without one

    @property
    def may_be_cut(self) -> Bool[Array, " M"]:
        """Whether the frame's border may cut off each box."""
        return np.asarray(self.cut.any(axis=(1, 2)))

    def find_outward(self) -> Float[Array, "M 2"]:
        """Find unit vectors to the border that may cut off each box; 0 where none may."""
        ends = self.cut.astype(float)
        right = np.column_stack([np.cos(self.axis), np.sin(self.axis)])
        outward = right * (ends[:, :1, 1] - ends[:, :1, 0])
        outward += self.down * (ends[:, 1:, 1] - ends[:, 1:, 0])
        length = np.hypot(*outward.T)[:, None]
        return np.asarray(outward / np.maximum(length, 1e-9) * (length > 0.5))


def place_boxes(
    frames: Sequence[DetectedBoxes | None],
    world_from_frame: Float[Array, "T 3 3"],
    size: tuple[int, int],
) -> GroundDetections:
    """Place the boxes of all frames, of a (height, width) in pixels, on the ground.

    Frames whose boxes (None) or transform from pixels to metres (NaN) are not known are left out.
    """
    known = [
        (step, boxes)
        for step, (boxes, matrix) in enumerate(zip(frames, world_from_frame, strict=True))
        if boxes is not None and np.isfinite(matrix).all()
    ] or [(0, DetectedBoxes(np.empty((0, 4))))]
    # many frames at once, since small arrays of each would stay in memory, and all at once fill it
    parts = [
        _place(known[begin : begin + FRAMES_AT_ONCE], world_from_frame, size)
        for begin in range(0, len(known), FRAMES_AT_ONCE)
    ]
    names = GroundDetections.__dataclass_fields__
    return GroundDetections(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    )


def _place(
    known: list[tuple[int, DetectedBoxes]],
    world_from_frame: Float[Array, "T 3 3"],
    size: tuple[int, int],
) -> GroundDetections:
    """Place the boxes of frames, by their numbers, on the ground."""
    counts = [len(boxes.boxes) for _, boxes in known]
    step = np.repeat([number for number, _ in known], counts)
    oriented = np.repeat([boxes.corners is not None for _, boxes in known], counts)
    bounds = np.concatenate([boxes.boxes for _, boxes in known])
    corners = np.concatenate([boxes.get_corners() for _, boxes in known])
    matrix = world_from_frame[step]
    position = transform_points(matrix, corners.mean(axis=1, keepdims=True))[:, 0]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
    start, sides = corners[:, :1], MID_SIDES[None]
    ends = start + sides[..., :1] * first[:, None] + sides[..., 1:] * second[:, None]
    ground = transform_points(matrix, ends)
    along, across = ground[:, 1] - ground[:, 0], ground[:, 3] - ground[:, 2]
    extent = np.column_stack([np.hypot(*along.T), np.hypot(*across.T)])
    pixels = np.hypot(*first.T) * np.hypot(*second.T)
    limits = np.array(size[::-1])
    cut = np.stack([bounds[:, :2] < BORDER_PX, bounds[:, 2:] > limits - BORDER_PX], -1)
    # an end of a turned box is cut off if a corner of it is: two opposite ends, if all along a side
    near = ((corners < BORDER_PX) | (corners > limits - BORDER_PX)).any(axis=2)
    near |= np.concatenate([boxes.get_at_border() for _, boxes in known])
    turned = near[:, END_CORNERS].any(axis=3)
    cut = np.where(oriented[:, None, None], turned, cut)
    resolution = np.sqrt(extent.prod(axis=1) / np.maximum(pixels, 1e-9))
    return GroundDetections(
        step=step,
        position=position,
        axis=np.arctan2(along[:, 1], along[:, 0]),
        down=across / np.maximum(extent[:, 1:], 1e-9),
        extent=extent,
        oriented=oriented,
        cut=cut,
        resolution=resolution,
        view=resolution**2 * size[0] * size[1],
        score=np.concatenate([boxes.get_scores() for _, boxes in known]),
        types=np.concatenate([boxes.get_types() for _, boxes in known]),
        roof_sigma=np.zeros(len(step)),
    )


def select_detections(detections: GroundDetections, chosen: Array) -> GroundDetections:
    """Select detections by a mask or by numbers."""
    fields = GroundDetections.__dataclass_fields__
    return replace(detections, **{name: getattr(detections, name)[chosen] for name in fields})
