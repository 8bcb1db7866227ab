"""Boxes that the frame's border cuts off: their middles by the agent's size."""

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from geoaim.tracking.ground_detections import GroundDetections
from geoaim.tracking.sizes import predict_extents


def complete_cut_boxes(
    detections: GroundDetections,
    track: Int[Array, "M"],
    headings: Float[Array, "M"],
    sizes: Float[Array, "N 2"],
) -> Float[Array, "M 2"]:
    """Move the middles of cut boxes to where those of the whole boxes are, m.

    The end that lies inside the frame stays; the other one is as far from it as the agent's size
    (m) and its heading at the detection (rad) tell. A larger box stays as it is.
    """
    position = detections.position.copy()
    for row in np.flatnonzero(detections.may_be_cut):
        agent, axis = track[row], detections.axis[row]
        turn = headings[row] - axis
        whole = predict_extents(sizes[agent], np.array([turn]))[0]
        missing = np.maximum(whole - detections.extent[row], 0.0)
        # the start of a side cut off: the middle moves against the side; its end: along it
        along = missing / 2 * (detections.cut[row, :, 1] * 1.0 - detections.cut[row, :, 0])
        right = np.array([np.cos(axis), np.sin(axis)])
        down = detections.down[row]
        position[row] += along[0] * right + along[1] * down
    return position
