"""A picture of an AIM and of its report, for people: what to trust, at a glance."""

import os
from collections.abc import Mapping
from dataclasses import replace
from textwrap import shorten
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.files import write_figure
from geoaim.geometry import transform_points
from geoaim.grid import Grid, north_up_grid
from geoaim.tracks import Tracks

LOOK = 900  # px of the longer side of a drawn alignment
SQUARES = 10  # along it
WHY = 70  # letters of the reason why something could not be checked
ACCENT, BAD = "#ff6a00", "#c1121f"


def draw_quicklook(aim: AIM) -> Figure:
    """Draw the background with its control points, the drift, the coverage and the figures."""
    figure = Figure(figsize=(14, 6.4), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=[2.4, 1])
    _draw_points(figure.add_subplot(grid[:, 0]), aim)
    _draw_path(figure.add_subplot(grid[0, 1]), aim.report.get("registration", {}))
    _draw_coverage(figure.add_subplot(grid[1, 1]), aim)
    _draw_summary(figure.add_subplot(grid[2, 1]), aim)
    return figure


def write_quicklook(aim: AIM, path: str | os.PathLike[str]) -> None:
    """Write `draw_quicklook` as a PNG."""
    write_figure(draw_quicklook(aim), path)


def draw_alignment(imagery: AIM, *, aim: AIM | None = None, tracks: Tracks | None = None) -> Figure:
    """Draw imagery before and after it was moved, beside an AIM's squares and under tracks.

    Args:
        imagery: what `align_tiles` gave.
        aim: drawn in every other square.
        tracks: in the same world.
    """
    figure = Figure(figsize=(15, 7.5), layout="constrained")
    stated = _as_stated(imagery)
    corners = (imagery if aim is None else aim).corners
    for axes, shown, title in zip(
        figure.subplots(1, 2), (stated, imagery), ("as stated", "aligned"), strict=True
    ):
        view, extent = _squares(shown, aim, corners)
        axes.imshow(view, extent=extent)
        if tracks is not None:
            for states, there in zip(tracks.states, tracks.present, strict=True):
                axes.plot(*states[there, :2].T, "-", color=ACCENT, linewidth=0.7, alpha=0.8)
        axes.set(title=title, xlabel="x, m", ylabel="y, m", xlim=extent[:2], ylim=extent[2:])
    return figure


def _as_stated(imagery: AIM) -> AIM:
    """The imagery where it lay before evidence moved it."""
    report: Any = imagery.report.get("alignment", {})
    for said in report.values():
        if "checked" not in said:
            back = np.linalg.inv(np.array(said["true_from_stated"]))
            return replace(imagery, world_from_image=back @ imagery.world_from_image)
    return imagery


def _squares(
    shown: AIM, aim: AIM | None, corners: Float[Array, "4 2"]
) -> tuple[UInt8[Array, "H W 3"], tuple[float, float, float, float]]:
    """The imagery on a grid over the corners, with the AIM in every other square."""
    wide, high = np.ptp(corners, axis=0)
    grid = north_up_grid(corners, float(max(wide, high)) / LOOK)
    view, _ = _on_grid(shown, grid)
    if aim is not None:
        other, there = _on_grid(aim, grid)
        rows, columns = np.indices(grid.shape) * SQUARES // LOOK
        swapped = there & ((rows + columns) % 2 == 0)
        view = np.where(swapped[..., None], other, view)
    (left, top), (right, low) = grid.corners[[0, 2]]
    return view, (left, right, low, top)


def _on_grid(aim: AIM, grid: Grid) -> tuple[UInt8[Array, "H W 3"], Bool[Array, "H W"]]:
    """The nearest pixels, and where there are any; white where none."""
    rows, columns = np.indices(grid.shape) + 0.5
    image_from_grid = aim.grid.grid_from_world @ grid.world_from_grid
    places = transform_points(image_from_grid, np.stack([columns, rows], -1).reshape(-1, 2))
    u, v = np.floor(places).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < aim.image.shape[1]) & (v < aim.image.shape[0])
    inside[inside] = aim.coverage[v[inside], u[inside]] > 0
    view = np.full((len(inside), 3), 255, np.uint8)
    view[inside] = aim.image[v[inside], u[inside]]
    return view.reshape(*grid.shape, 3), inside.reshape(grid.shape)


def summary(aim: AIM) -> dict[str, str]:
    """The report in a dozen short lines."""
    report: Any = aim.report
    place, frames, ground = (
        report.get(stage, {}) for stage in ("georeference", "registration", "background")
    )
    height, width = aim.image.shape[:2]
    size = np.linalg.norm(np.roll(aim.corners, -1, 0) - aim.corners, axis=1)
    lines = {
        "image": f"{width} x {height} px, {(size[0] + size[2]) / 2:.0f} x "
        f"{(size[1] + size[3]) / 2:.0f} m",
        "world": f"{aim.world.crs or 'local plane'}, origin "
        f"{aim.world.origin[0]:.0f}, {aim.world.origin[1]:.0f}",
    }
    if frames:
        lines["motion model"] = frames["model"]
        lines["frames laid"] = f"{frames['valid']} of {frames['frames']}"
        lines["registration"] = f"{frames['uncertainty_px']:.3f} px (1 sigma, corners)"
    if ground:
        lines["background"] = f"{ground['method']} of {ground['frames_used']} frames"
        lines["contested"] = f"{ground['contested_share']:.2%} of the pixels"
    if place:
        kind = "approximate, " if place["approximate"] else ""
        lines["georeference"] = kind + place["model"]
        worst = max(place["corner_uncertainty_m"])
        lines["corner uncertainty"] = f"{worst:.2f} m (95 %)"
        if place["points"]:
            errors = [p["leave_one_out_m"] for p in place["points"] if p["used"]]
            rms = np.sqrt(np.mean(np.square(errors)))
            lines["leave-one-out"] = f"{rms:.4f} m (rms of {len(errors)} points)"
    for name, said in report.get("alignment", {}).items():
        if "checked" in said:
            lines[f"by {name}"] = _check_in_short(said)
        else:
            east, north = said["shift_m"]
            lines[f"by {name}"] = (
                f"{said['model']}, {east:+.2f} m east, {north:+.2f} m north, "
                f"{said['turn_degrees']:+.2f} degrees; {said['uncertainty_m']:.2f} m (95 %)"
            )
            if said["undetermined_degrees"] is not None:
                lines["undetermined"] = f"along {said['undetermined_degrees'] % 180:.0f} degrees"
    return lines


def _check_in_short(said: Mapping[str, Any]) -> str:
    """What evidence says of a place that other evidence found."""
    if not said["checked"]:
        return f"could not check: {shorten(said['why'], WHY, placeholder=' ...')}"
    found = f"corners {said['corners_off_m']:.2f} m off, known to {said['corners_known_to_m']:.2f}"
    return f"{'agrees' if said['agrees'] else 'DISAGREES'}: {found} m (95 %)"


def _draw_points(axes: Axes, aim: AIM) -> None:
    height, width = aim.image.shape[:2]
    axes.imshow(aim.image, extent=(0, width, height, 0))
    points = aim.report.get("georeference", {}).get("points", [])
    title = "background, control points, residuals x 50" if points else "background"
    axes.set(title=title, xlabel="u, px", ylabel="v, px")
    image_from_world = np.linalg.inv(aim.world_from_image)
    shade = {"facecolor": "black", "alpha": 0.5, "pad": 1}
    for point in points:
        x, y = point["x"], point["y"]
        ends = np.array([[x, y], [x + point["residual_x"], y + point["residual_y"]]])
        start, end = transform_points(image_from_world, ends)
        colour = ACCENT if point["used"] else BAD
        axes.plot(*start, "o", color=colour, markersize=7, fillstyle="none", markeredgewidth=2)
        axes.arrow(*start, *(50 * (end - start)), color=colour, width=width / 600)
        axes.text(start[0] + 8, start[1] + 8, point["name"], color="white", fontsize=8, bbox=shade)
    axes.set(xlim=(0, width), ylim=(height, 0))


def _draw_path(axes: Axes, frames: dict[str, Any]) -> None:
    axes.set_title("drift of the view's centre, px", fontsize=9)
    path = np.array(sorted(frames.get("path", [])), float).reshape(-1, 3)
    if len(path):
        axes.plot(path[:, 1], path[:, 2], "-", color="0.7", linewidth=0.8)
        drawn = axes.scatter(path[:, 1], path[:, 2], c=path[:, 0], s=12, cmap="viridis")
        axes.figure.colorbar(drawn, ax=axes, label="time, s")
        axes.set_aspect("equal", "datalim")
        axes.tick_params(labelsize=7)
        axes.ticklabel_format(useOffset=False)
        axes.invert_yaxis()


def _draw_coverage(axes: Axes, aim: AIM) -> None:
    height, width = aim.image.shape[:2]
    drawn = axes.imshow(aim.coverage[::4, ::4], extent=(0, width, height, 0), vmin=0, cmap="magma")
    axes.figure.colorbar(drawn, ax=axes, label="frames")
    contested = np.where(aim.contested[::4, ::4], 1.0, np.nan)
    axes.imshow(contested, extent=(0, width, height, 0), cmap="cool", vmin=0, vmax=1)
    axes.set_title("frames behind each pixel (magenta: contested)", fontsize=9)
    axes.set(xticks=[], yticks=[])


def _draw_summary(axes: Axes, aim: AIM) -> None:
    axes.axis("off")
    lines = summary(aim)
    left = max(map(len, lines))
    text = "\n".join(f"{name:<{left}}  {value}" for name, value in lines.items())
    axes.text(0, 1, text, family="monospace", fontsize=8, va="top", transform=axes.transAxes)
