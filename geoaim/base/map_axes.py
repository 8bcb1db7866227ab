"""Axes of maps in metres: they remember their world, and have a scale bar."""

from collections.abc import Iterable
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patheffects import withStroke
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from numpy import ndarray as Array

from geoaim.base.geometry import transform_points
from geoaim.base.grid import Grid, make_north_up_grid
from geoaim.base.texts import plot_text
from geoaim.base.world import World, change_world

LONGER_SIDE_PX = 1200  # longer side of an image as it is drawn
USED_COLOUR, UNUSED_COLOUR = "#ff6a00", "#c1121f"  # colours of control points
_worlds: WeakKeyDictionary[Axes, World] = WeakKeyDictionary()


def move_to_axes(
    axes: Axes, points: Float[Array, "*any 2"], world: World | None
) -> Float[Array, "*any 2"]:
    """Move points (m) to the world of the axes: the world of what was first drawn in them.

    Raises:
        GeoreferenceError: only one of the two worlds has a CRS.
    """
    if world is None:
        return points
    here = _worlds.setdefault(axes, world)
    return change_world(world, here, points.reshape(-1, 2)).reshape(points.shape)


def draw_image(
    axes: Axes,
    image: UInt8[Array, "H W 3"],
    grid: Grid,
    covered: Bool[Array, "H W"],
    bounds: Float[Array, "2 2"] | None = None,
) -> None:
    """Draw the covered pixels of an image of the ground north up, or its part in bounds (m)."""
    corners = move_to_axes(axes, grid.corners, grid.world)
    corners = corners if bounds is None else bounds
    longer = float(np.ptp(corners, axis=0).max())
    drawn = make_north_up_grid(corners, max(longer / LONGER_SIDE_PX, grid.resolution))
    v, u = np.indices(drawn.shape).reshape(2, -1) + 0.5
    points = transform_points(drawn.world_from_grid, np.column_stack([u, v]))
    if grid.world is not None:
        points = change_world(_worlds[axes], grid.world, points)
    column, row = np.floor(transform_points(grid.grid_from_world, points)).astype(int).T
    inside = (row >= 0) & (row < grid.height) & (column >= 0) & (column < grid.width)
    row, column = np.where(inside, row, 0), np.where(inside, column, 0)
    alpha = 255 * (inside & covered[row, column])
    pixels = np.column_stack([image[row, column], alpha]).astype(np.uint8)
    (left, top), (right, bottom) = drawn.corners[[0, 2]]
    extent = (left, right, bottom, top)
    axes.imshow(pixels.reshape(*drawn.shape, 4), extent=extent, zorder=0)


def draw_lines(
    axes: Axes,
    lines: Iterable[Float[Array, "_ 2"]],
    colour: str | tuple[float, float, float],
    *,
    width: float = 0.8,
    label: str = "",
    outlined: bool = False,
) -> None:
    """Draw lines in the axes' world, with one entry in the legend unless `label` is empty.

    An outline makes pale lines visible on pale ground.
    """
    drawn = LineCollection(
        list(lines), colors=[colour], linewidths=width, label=plot_text(label) or None
    )
    if outlined:
        outline = withStroke(linewidth=width + 2, foreground="black")
        drawn.set_path_effects([outline])
    axes.add_collection(drawn)
    axes.autoscale_view()


def label_place(axes: Axes, name: str, place: Float[Array, "2"]) -> None:
    """Write a name beside a place (m, in the axes' world), in white on a dark ground."""
    shade = {"facecolor": "black", "alpha": 0.55, "pad": 1, "linewidth": 0}
    text = axes.annotate(
        plot_text(name), place.tolist(), (4, 4), textcoords="offset points", fontsize=7
    )
    text.set(color="white", bbox=shade, clip_on=True)


def add_legend(axes: Axes) -> None:
    """Add a legend beside the axes, if anything in them has a label."""
    handles, labels = axes.get_legend_handles_labels()
    entries = dict(zip(labels, handles, strict=True))
    if entries:
        legend = axes.legend(
            list(entries.values()),
            list(entries),
            loc="upper left",
            bbox_to_anchor=(1.01, 1.0),
            borderaxespad=0.0,
            fontsize=8,
            frameon=False,
        )
        for shown, drawn in zip(legend.legend_handles, entries.values(), strict=True):
            if shown is not None:
                shown.set_path_effects(drawn.get_path_effects())


def add_scale_bar(axes: Axes) -> None:
    """Make axes a map: equal aspect, metres at both axes, and a scale bar of a round length.

    A world without a CRS may be turned in any direction, so that no north is named.
    """
    world = _worlds.get(axes)
    north_up = world is None or world.crs is not None
    x, y = ("x (east), m", "y (north), m") if north_up else ("x, m", "y, m")
    axes.set(xlabel=x, ylabel=y)
    axes.set_aspect("equal")
    for drawn in [artist for artist in axes.artists if isinstance(artist, AnchoredSizeBar)]:
        drawn.remove()
    longest = 0.3 * abs(float(np.subtract(*axes.get_xlim())))  # of the axes' width
    power = 10.0 ** np.floor(np.log10(longest))
    length = power * max(n for n in (1, 2, 5) if n * power <= longest)
    text = f"{length:g} m, north up" if north_up else f"{length:g} m"
    # letters reach above their box by 6 points
    bar = AnchoredSizeBar(axes.transData, length, text, "lower right", pad=0.4, sep=6)
    axes.add_artist(bar)


def draw_drift(
    axes: Axes, times: Float[Array, " T"], offsets: Float[Array, "T 2"], origin: str
) -> None:
    """Draw where the middles of frames lie, in pixels from that of the frame `origin`."""
    axes.plot(*offsets.T, "-", color="0.7", linewidth=0.8)
    drawn = axes.scatter(offsets[:, 0], offsets[:, 1], c=times, s=12, cmap="viridis", zorder=2)
    axes.plot(0, 0, "+", color="#c1121f", markersize=10, label=origin)
    axes.legend(fontsize=7)
    axes.set_aspect("equal", "datalim")
    axes.set(xlabel="right, px", ylabel="down, px")
    axes.invert_yaxis()
    axes.set_anchor("W")
    figure = axes.get_figure()
    if figure is not None:
        figure.colorbar(drawn, cax=axes.inset_axes((1.02, 0, 0.03, 1)), label="time, s")
    widest = float(np.abs(offsets).max(initial=1.0))
    axes.set_title(f"drift of the view, up to {widest:.0f} px", fontsize=9, loc="left")
