"""Pictures of an AIM: with its report at a glance, and before and after its alignment."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.aim_summary import summarize_aim
from geoaim.geometry import transform_points
from geoaim.grid import Grid, make_north_up_grid
from geoaim.rectification import sample_nearest
from geoaim.tracks import Tracks

RESIDUAL_SCALES = (50, 20, 10, 5, 2, 1)  # residuals of control points are drawn as much longer
LONGEST_RESIDUAL = 0.2  # of the image's width, as drawn
RASTER_STRIDE = 4  # of the pixels of the coverage that are drawn
USED_COLOUR, UNUSED_COLOUR = "#ff6a00", "#c1121f"  # of control points
LONGER_SIDE_PX = 900
SQUARES_PER_SIDE = 10  # of the checkerboard, along the longer side
TRACK_COLOUR = "#ff6a00"
Extent = tuple[float, float, float, float]  # left, right, bottom, top in metres


def draw_quicklook(aim: AIM) -> Figure:
    """Draw an AIM: its image with control points, drift, coverage, uncertainty and summary."""
    figure = Figure(figsize=(14, 6.4), layout="constrained")
    grid = figure.add_gridspec(4, 2, width_ratios=[2.4, 1])
    _draw_points(figure.add_subplot(grid[:, 0]), aim)
    _draw_drift(figure.add_subplot(grid[0, 1]), aim.report.get("registration", {}))
    _draw_coverage(figure.add_subplot(grid[1, 1]), aim)
    _draw_uncertainty(figure.add_subplot(grid[2, 1]), aim.report.get("georeference", {}))
    _draw_summary(figure.add_subplot(grid[3, 1]), aim)
    return figure


def _draw_points(axes: Axes, aim: AIM) -> None:
    """Draw the image, and control points with their residuals."""
    height, width = aim.image.shape[:2]
    axes.imshow(aim.image, extent=(0, width, height, 0))
    points = aim.report.get("georeference", {}).get("points", [])
    image_from_world = np.linalg.inv(aim.world_from_image)
    ends = np.array(
        [[[p["x"], p["y"]], [p["x"] + p["residual_x"], p["y"] + p["residual_y"]]] for p in points]
    )
    ends = transform_points(image_from_world, ends.reshape(-1, 2)).reshape(-1, 2, 2)
    longest = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max(initial=0.0)
    scale = next((n for n in RESIDUAL_SCALES if n * longest <= LONGEST_RESIDUAL * width), 1)
    residuals = f"background, control points, residuals x {scale}"
    axes.set(title=residuals if points else "background", xlabel="u, px", ylabel="v, px")
    shade = {"facecolor": "black", "alpha": 0.5, "pad": 1}
    for point, (start, end) in zip(points, ends, strict=True):
        colour = USED_COLOUR if point["used"] else UNUSED_COLOUR
        axes.plot(*start, "o", color=colour, markersize=7, fillstyle="none", markeredgewidth=2)
        axes.arrow(*start, *(scale * (end - start)), color=colour, width=width / 600)
        label = axes.text(
            start[0] + 8, start[1] + 8, point["name"], color="white", fontsize=8, bbox=shade
        )
        label.set_clip_on(True)
    axes.set(xlim=(0, width), ylim=(height, 0))


def _draw_drift(axes: Axes, registration: Mapping[str, Any]) -> None:
    """Draw where the frames' centres lie in the reference."""
    axes.set_title("drift of the frame centre, px", fontsize=9, loc="left")
    path = np.array(sorted(registration.get("path", [])), float).reshape(-1, 3)
    if len(path):
        axes.plot(path[:, 1], path[:, 2], "-", color="0.7", linewidth=0.8)
        drawn = axes.scatter(path[:, 1], path[:, 2], c=path[:, 0], s=12, cmap="viridis")
        _add_scale(axes, drawn, "time, s")
        axes.set_aspect("equal", "datalim")
        axes.tick_params(labelsize=7)
        axes.ticklabel_format(useOffset=False)
        axes.invert_yaxis()


def _draw_coverage(axes: Axes, aim: AIM) -> None:
    height, width = aim.image.shape[:2]
    extent, step = (0, width, height, 0), slice(None, None, RASTER_STRIDE)
    drawn = axes.imshow(aim.coverage[step, step], extent=extent, vmin=0, cmap="magma")
    _add_scale(axes, drawn, "frames")
    contested = np.where(aim.contested[step, step], 1.0, np.nan)
    axes.imshow(contested, extent=extent, cmap="cool", vmin=0, vmax=1)
    axes.set_title("frames per pixel (magenta: contested)", fontsize=9, loc="left")
    axes.set(xticks=[], yticks=[])


def _draw_uncertainty(axes: Axes, georeference: Mapping[str, Any]) -> None:
    """Draw the 95 % radius over the image of the video, before any resampling."""
    axes.set_title("95 % uncertainty of the place over the frame", fontsize=9, loc="left")
    axes.set(xticks=[], yticks=[])
    if uncertainty := georeference.get("uncertainty"):
        drawn = axes.imshow(uncertainty["map_m"], vmin=0, cmap="viridis", interpolation="bilinear")
        _add_scale(axes, drawn, "m")


def _add_scale(axes: Axes, drawn: ScalarMappable, label: str) -> None:
    """Add a colour scale right beside a panel, which stands on the left of its place."""
    axes.set_anchor("W")
    axes.figure.colorbar(drawn, cax=axes.inset_axes((1.02, 0, 0.03, 1)), label=label)


def _draw_summary(axes: Axes, aim: AIM) -> None:
    axes.axis("off")
    lines = summarize_aim(aim)
    width = max(map(len, lines))
    text = "\n".join(f"{name:<{width}}  {value}" for name, value in lines.items())
    axes.text(0, 1, text, family="monospace", fontsize=8, va="top", transform=axes.transAxes)


def draw_alignment(imagery: AIM, *, aim: AIM | None = None, tracks: Tracks | None = None) -> Figure:
    """Draw imagery before and after alignment.

    Args:
        imagery: the result of `align_tiles`; without an alignment in its report, both are alike.
        aim: in the same world; shown in every other square of a checkerboard.
        tracks: in the same world; drawn on top.

    Returns:
        The figure, with the stated position on the left and the aligned one on the right.
    """
    figure = Figure(figsize=(15, 7.5), layout="constrained")
    stated = _undo_alignment(imagery)
    corners = (imagery if aim is None else aim).corners
    for axes, shown, title in zip(
        figure.subplots(1, 2), (stated, imagery), ("as stated", "aligned"), strict=True
    ):
        picture, extent = _draw_checkerboard(shown, aim, corners)
        axes.imshow(picture, extent=extent)
        if tracks is not None:
            for states, present in zip(tracks.states, tracks.present, strict=True):
                axes.plot(*states[present, :2].T, "-", color=TRACK_COLOUR, linewidth=0.7, alpha=0.8)
        axes.set(title=title, xlabel="x, m", ylabel="y, m", xlim=extent[:2], ylim=extent[2:])
    return figure


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
