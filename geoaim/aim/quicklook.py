"""A picture of an AIM with its report at a glance."""

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from geoaim.aim.aim import AIM
from geoaim.base.labels import label_points
from geoaim.base.map_axes import UNUSED_COLOUR, USED_COLOUR, draw_drift, draw_lines

MAP_INCHES, PANEL_INCHES = 8.0, 6.5  # height of the map, width of what stands beside it
RESIDUAL_SCALES = (50, 20, 10, 5, 2, 1)  # residuals of control points are drawn as much longer
# length of the longest residual as it is drawn, as a share of the map's width
LONGEST_RESIDUAL = 0.2


def draw_quicklook(aim: AIM) -> Figure:
    """Draw an AIM: its map with control points, drift, coverage, uncertainty and summary."""
    width, height = np.ptp(aim.corners, axis=0)
    shown = float(np.clip(MAP_INCHES * width / height, 4.0, 12.0))
    figure = Figure(figsize=(shown + PANEL_INCHES, MAP_INCHES + 0.6), layout="constrained")
    parts = figure.add_gridspec(1, 2, width_ratios=[shown, PANEL_INCHES])
    left, right = (figure.add_subfigure(parts[0, column]) for column in (0, 1))
    grid = right.add_gridspec(3, 2, height_ratios=[1.2, 1, 1])
    main = left.add_subplot()
    aim.plot(main)
    georeference = aim.report.get("georeference", {})
    if georeference.get("given_scale"):  # no place whose uncertainty could be drawn
        _draw_coverage(right.add_subplot(grid[0, :]), aim)
    else:
        _draw_coverage(right.add_subplot(grid[0, 0]), aim)
        _draw_uncertainty(right.add_subplot(grid[0, 1]), georeference)
    _draw_path(right.add_subplot(grid[1, :]), aim.report.get("registration", {}))
    _draw_summary(right.add_subplot(grid[2, :]), aim)
    _fix_layout(figure)  # labels are placed in the final one
    _draw_points(main, georeference.get("points", []))
    return figure


def _fix_layout(figure: Figure) -> None:
    """Lay the figure out as when it is drawn, which would take twice as long."""
    layout = figure.get_layout_engine()
    assert layout is not None
    layout.execute(figure)
    for axes in figure.get_axes():
        axes.apply_aspect()
    figure.set_layout_engine("none")


def _draw_points(axes: Axes, points: Sequence[Mapping[str, Any]]) -> None:
    """Draw control points with their residuals on the map, which has its layout."""
    axes.set_title("background", loc="left")
    if not points:
        return
    starts = np.array([[p["x"], p["y"]] for p in points])
    residuals = np.array([[p["residual_x"], p["residual_y"]] for p in points])
    longest = np.linalg.norm(residuals, axis=1).max()
    extent = abs(float(np.subtract(*axes.get_xlim())))
    scale = next((n for n in RESIDUAL_SCALES if n * longest <= LONGEST_RESIDUAL * extent), 1)
    axes.set_title(f"background, control points, and residuals {scale} times longer", loc="left")
    limits = {"xlim": axes.get_xlim(), "ylim": axes.get_ylim()}
    used = np.array([bool(p["used"]) for p in points])
    for chosen, colour, name in ((used, USED_COLOUR, "used"), (~used, UNUSED_COLOUR, "not used")):
        if chosen.any():
            [marks] = axes.plot(*starts[chosen].T, "o", color=colour, markersize=7)
            marks.set(fillstyle="none", markeredgewidth=2, label=f"control points, {name}")
            ends = starts[chosen] + scale * residuals[chosen]
            lines = np.stack([starts[chosen], ends], axis=1)
            draw_lines(axes, lines, colour, width=1.5, label=f"residual x {scale}, {name}")
    label_points(axes, starts, [p["name"] for p in points])
    axes.legend(loc="upper left", fontsize=8)
    axes.set(**limits)


def _draw_path(axes: Axes, registration: Mapping[str, Any]) -> None:
    """Draw where the frames' centres lie, relative to the first one's."""
    axes.set_title("no drift in the report", fontsize=9, loc="left")
    path = np.array(sorted(registration.get("path", [])), float).reshape(-1, 3)
    if len(path):
        draw_drift(axes, path[:, 0], path[:, 1:] - path[0, 1:], "first frame")
        axes.tick_params(labelsize=7)


def _draw_coverage(axes: Axes, aim: AIM) -> None:
    height, width = aim.image.shape[:2]
    extent, step = (0, width, height, 0), slice(None, None, 4)  # every fourth pixel is drawn
    drawn = axes.imshow(aim.coverage[step, step], extent=extent, vmin=0, cmap="magma")
    _add_scale(axes, drawn, "frames")
    contested = np.where(aim.contested[step, step], 1.0, np.nan)
    axes.imshow(contested, extent=extent, cmap="cool", vmin=0, vmax=1)
    axes.set_title("frames per pixel\n(magenta: contested)", fontsize=9, loc="left")
    axes.set(xticks=[], yticks=[])


def _draw_uncertainty(axes: Axes, georeference: Mapping[str, Any]) -> None:
    """Draw the 95 % radius over the image of the video, before any resampling."""
    axes.set_title(
        "uncertainty of the place (95 %)\nover the frame of the video", fontsize=9, loc="left"
    )
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
    lines = aim.summarize()
    width = max(map(len, lines))
    room = max(80 - width - 2, 20)  # 80 characters fit into the panel
    rows = [
        f"{name if number == 0 else '':<{width}}  {part}"
        for name, value in lines.items()
        for number, part in enumerate(wrap(value, room) or [""])
    ]
    text = "\n".join(rows)
    axes.text(0, 1, text, family="monospace", fontsize=8, va="top", transform=axes.transAxes)
