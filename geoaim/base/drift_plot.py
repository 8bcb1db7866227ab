"""Draw the drift of a hovering camera."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from numpy import ndarray as Array


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
