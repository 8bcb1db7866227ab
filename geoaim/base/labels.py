"""Names beside points of a picture, placed so that they cover neither points nor each other."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox
from numpy import ndarray as Array

DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
LABEL_PX = (7.0, 14.0, 28.0)  # tried between a mark and its label


def label_points(axes: Axes, points: Float[Array, "n 2"], names: Sequence[str]) -> list[Annotation]:
    """Write each point's name beside it, where it covers no point and no other name.

    Args:
        axes: axes of a figure whose layout is done.
        points: (M, 2) points in the data coordinates of the axes.
        names: the names to write beside the points.

    Returns:
        The texts; none of points that are not finite.
    """
    shown, frame = np.isfinite(points).all(1), axes.bbox.frozen()
    places = axes.transData.transform(points[shown])
    texts, taken = [], [Bbox.from_extents(*(place - 4), *(place + 4)) for place in places]
    for place, point, name in zip(places, points[shown], np.array(names)[shown], strict=True):
        text = axes.annotate(str(name), point, xytext=(0, 0), textcoords="offset points")
        text.set(fontsize=8)
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8})
        size = np.array(text.get_window_extent().size)
        boxes = [
            Bbox.from_bounds(*(place + gap * np.array(way) + (np.array(way) - 1) / 2 * size), *size)
            for gap, way in product(LABEL_PX, DIRECTIONS)
        ]
        others = places[(places != place).any(1)]
        best = min(boxes, key=lambda box: _count_conflicts(box, taken, frame, (place, others)))
        text.xyann = tuple((best.min - place) * 72 / text.figure.dpi)
        taken.append(best)
        texts.append(text)
    return texts


def _count_conflicts(
    box: Bbox, taken: list[Bbox], frame: Bbox, places: tuple[Float[Array, "2"], Float[Array, "m 2"]]
) -> int:
    """Count boxes that a name overlaps, sides of the frame that it crosses, and points that are
    as near to it as its own."""
    crossed = sum([box.x0 < frame.x0, box.x1 > frame.x1, box.y0 < frame.y0, box.y1 > frame.y1])
    own, others = (np.linalg.norm(p - p.clip(box.min, box.max), axis=-1) for p in places)
    return int(2 * box.count_overlaps(taken) + 4 * crossed + (others < own + 3).sum())
