"""Names beside points of a chart, which cover neither points nor each other; logarithmic axes."""

from collections.abc import Sequence
from functools import partial
from itertools import product

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.text import Annotation
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from matplotlib.transforms import Bbox
from numpy import ndarray as Array

from geoaim.base.texts import plot_text

DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))
LABEL_PX = (7.0, 14.0, 28.0)  # tried between a mark and its label
ROUNDS = 3  # times that each name is placed


def label_points(axes: Axes, points: Float[Array, "n 2"], names: Sequence[str]) -> list[Annotation]:
    """Write the name of each finite point beside it, where it covers no point and no other name."""
    shown, frame = np.isfinite(points).all(1), axes.bbox.frozen()
    places = axes.transData.transform(points[shown])
    marks = [Bbox.from_extents(*(place - 4), *(place + 4)) for place in places]
    texts = [
        _write_name(axes, str(name), point)
        for point, name in zip(points[shown], np.array(names)[shown], strict=True)
    ]
    chosen: list[Bbox] = []
    for turn in range(ROUNDS):  # each name again, when the others have their places
        for index, (place, text) in enumerate(zip(places, texts, strict=True)):
            size = np.array(text.get_window_extent().size)
            boxes = [
                _place_box(place, gap, way, size) for gap, way in product(LABEL_PX, DIRECTIONS)
            ]
            others = places[(places != place).any(1)]
            taken = marks + (chosen if turn == 0 else chosen[:index] + chosen[index + 1 :])
            count = partial(_count_conflicts, taken=taken, frame=frame, places=(place, others))
            best = min(boxes, key=count)
            chosen[index : index + 1] = [best]
            text.xyann = tuple((best.min - place) * 72 / text.figure.dpi)
    return texts


def _write_name(axes: Axes, name: str, point: Float[Array, "2"]) -> Annotation:
    text = axes.annotate(
        plot_text(name), (point[0], point[1]), xytext=(0, 0), textcoords="offset points"
    )
    text.set(fontsize=8)
    text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8})
    return text


def _place_box(
    place: Float[Array, "2"], gap: float, way: tuple[int, int], size: Float[Array, "2"]
) -> Bbox:
    """The box of a name at a distance from its mark, in a direction."""
    direction = np.array(way)
    return Bbox.from_bounds(*(place + gap * direction + (direction - 1) / 2 * size), *size)


def _count_conflicts(
    box: Bbox, taken: list[Bbox], frame: Bbox, places: tuple[Float[Array, "2"], Float[Array, "m 2"]]
) -> int:
    """Count boxes that a name overlaps, sides of the frame that it crosses, and points that are
    as near to it as its own."""
    crossed = sum([box.x0 < frame.x0, box.x1 > frame.x1, box.y0 < frame.y0, box.y1 > frame.y1])
    own, others = (np.linalg.norm(p - p.clip(box.min, box.max), axis=-1) for p in places)
    return int(2 * box.count_overlaps(taken) + 4 * crossed + (others < own + 3).sum())


def scale_axes(axes: Axes) -> None:
    """Make both axes logarithmic, with plain numbers and a grid."""
    axes.set(xscale="log", yscale="log")
    axes.grid(alpha=0.25)
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        subs = (
            (1.0, 1.5, *range(2, 10)) if high < 4 * low else (1, 2, 5) if high < 200 * low else (1,)
        )
        axis.set_major_locator(LogLocator(subs=subs))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())
