"""A picture of imagery before and after its alignment."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.rectification import sample_nearest
from geoaim.base.grid import Grid, make_north_up_grid
from geoaim.base.map_axes import add_scale_bar, draw_lines
from geoaim.tracks.tracks import Tracks

LONGER_SIDE_PX = 900
SQUARES_PER_SIDE = 10  # squares of the checkerboard along the longer side
TRACK_COLOUR = "#ff6a00"
Extent = tuple[float, float, float, float]  # left, right, bottom, top in metres


def draw_alignment(imagery: AIM, *, aim: AIM | None = None, tracks: Tracks | None = None) -> Figure:
    """Draw imagery before and after alignment.

    Args:
        imagery: the result of `align_tiles`; without an alignment in its report, both are alike.
        aim: an AIM in the same world, shown in every other square of a checkerboard.
        tracks: tracks in the same world, drawn on top.

    Returns:
        The figure, with the stated position on the left and the aligned one on the right; if
        windows of an AIM aligned it, also how far each of them is off, by parts of the imagery.
    """
    residuals = _find_residuals(imagery)
    columns = 2 if residuals is None else 3
    figure = Figure(figsize=(7.5 * columns, 7.5), layout="constrained")
    stated = _undo_alignment(imagery)
    corners = (imagery if aim is None else aim).corners
    pictures, *others = np.split(figure.subplots(1, columns), [2])
    if residuals is not None:
        _draw_window_residuals(others[0][0], residuals, imagery)
    for axes, shown, title in zip(
        pictures, (stated, imagery), ("as stated", "aligned"), strict=True
    ):
        picture, extent = _draw_checkerboard(shown, aim, corners)
        axes.imshow(picture, extent=extent)
        if tracks is not None:
            draw_lines(axes, tracks.states[..., :2], TRACK_COLOUR, width=0.7, label="tracks")
            axes.legend(loc="upper right", fontsize=8)
        axes.set(title=title, xlim=extent[:2], ylim=extent[2:])
        add_scale_bar(axes)
    return figure


def _find_residuals(imagery: AIM) -> Float[Array, "M 5"] | None:
    """Number of the part, x, y and the residual in x and y (m) of windows, from the report."""
    for alignment in imagery.report.get("alignment", {}).values():
        if "checked" not in alignment and "residuals" in alignment:
            return np.array(alignment["residuals"])
    return None


def _draw_window_residuals(axes: Axes, residuals: Float[Array, "M 5"], imagery: AIM) -> None:
    """Draw the residuals of windows as arrows, in a colour for each part of the imagery."""
    part, x, y, east, north = residuals.T
    lengths = np.hypot(east, north)
    key = float(f"{np.percentile(lengths, 90) + 1e-3:.1g}")
    width = float(np.ptp(imagery.corners[:, 0]))
    scale = key / (0.05 * width)
    colours = [f"C{int(number) % 10}" for number in part]
    arrows = axes.quiver(
        x, y, east, north, color=colours, angles="xy", scale_units="xy", scale=scale, width=0.003
    )
    axes.quiverkey(arrows, 0.85, 1.03, key, f"{key:g} m", labelpos="E")
    axes.set_aspect("equal")
    typical = float(np.median(lengths))
    parts = len(np.unique(part))
    title = f"residuals of {len(part)} windows, median {typical:.2f} m"
    axes.set_title(title if parts == 1 else f"{title}; {parts} parts", loc="left")


def _undo_alignment(imagery: AIM) -> AIM:
    """Move imagery back to its stated position."""
    report: Any = imagery.report.get("alignment", {})
    for alignment in report.values():
        if "checked" not in alignment:
            stated_from_true = np.linalg.inv(np.array(alignment["true_from_stated"]))
            return replace(imagery, world_from_image=stated_from_true @ imagery.world_from_image)
    return imagery


def _draw_checkerboard(
    imagery: AIM, aim: AIM | None, corners: Float[Array, "4 2"]
) -> tuple[UInt8[Array, "H W 3"], Extent]:
    """Draw imagery on a grid over the corners, with the AIM in every other square."""
    resolution = float(np.ptp(corners, axis=0).max()) / LONGER_SIDE_PX
    grid = make_north_up_grid(corners, resolution)
    picture, _ = _sample(imagery, grid)
    if aim is not None:
        other, covered = _sample(aim, grid)
        rows, columns = np.indices(grid.shape) * SQUARES_PER_SIDE // LONGER_SIDE_PX
        square = covered & ((rows + columns) % 2 == 0)
        picture = np.where(square[..., None], other, picture)
    (left, top), (right, bottom) = grid.corners[[0, 2]]
    return picture, (left, right, bottom, top)


def _sample(aim: AIM, grid: Grid) -> tuple[UInt8[Array, "H W 3"], Bool[Array, "H W"]]:
    """Sample the nearest pixels on a grid, white where none is covered, and the mask of cover."""
    image_from_grid = aim.grid.grid_from_world @ grid.world_from_grid
    covered = sample_nearest(aim.coverage, image_from_grid, grid.shape) > 0
    image = sample_nearest(aim.image, image_from_grid, grid.shape)
    return np.where(covered[..., None], image, np.uint8(255)), covered
