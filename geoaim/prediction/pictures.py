"""Futures on the map as a picture and frames of a film, and as a table."""

import json
import os
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy import ndarray as Array

from geoaim.base.files import atomic_write
from geoaim.base.map_axes import add_legend, add_scale_bar, move_to_axes
from geoaim.base.world import World, change_world
from geoaim.prediction.futures import Futures
from geoaim.tracks.files import format_world

PANEL_INCHES = 5.0  # side of one of several maps
PANEL_MARGIN_M = 20.0  # about the paths that panels show
PICTURE_INCHES = 10.0  # the longer side of the map
BESIDE_INCHES, BELOW_INCHES = 2.6, 1.0  # space for the legend and for the axes' labels


def draw_futures(futures: Futures) -> Figure:
    """Draw the map, north up, with agents at the start, all futures, and what was recorded."""
    figure = _make_figure(futures)
    futures.plot(figure.add_subplot())
    return figure


def draw_panels(rows: Sequence[Sequence[Futures]], titles: Sequence[str]) -> Figure:
    """Draw futures of one place in rows and columns, all of the same square of ground.

    Args:
        rows: rows of equally many futures, such as one for each duration.
        titles: a title of each column, such as the name of its map.

    Returns:
        The figure, with metres of the first map.
    """
    shape = len(rows), len(titles)
    size = PANEL_INCHES * shape[1] + BESIDE_INCHES, PANEL_INCHES * shape[0]
    figure = Figure(figsize=size, dpi=100, layout="compressed")  # no gaps between equal squares
    grid = figure.subplots(*shape, squeeze=False, sharex=True, sharey=True)
    limits, world = _fit_square(rows), rows[0][0].world
    for row, (panels, futures_of_row) in enumerate(zip(grid, rows, strict=True)):
        for axes, futures, title in zip(panels, futures_of_row, titles, strict=True):
            (left, bottom), (right, top) = move_to_axes(axes, limits, world).tolist()
            own = limits
            if world is not None and futures.world is not None:
                own = change_world(world, futures.world, limits)
            futures.scene.draw_ground(axes, own)
            futures.draw_step(axes, None)
            axes.set_title(title if row == 0 else "")
            axes.set(xlim=(left, right), ylim=(bottom, top))
            axes.set_aspect("equal")
        seconds = futures.states.shape[2] * futures.dt
        panels[0].set_ylabel(f"{len(futures.states)} futures of {seconds:g} s; metres")
    add_legend(grid[0, -1])
    return figure


def _fit_square(rows: Sequence[Sequence[Futures]]) -> Float[Array, "2 2"]:
    """Lowest and highest x and y of a square with all paths of the predicted agents, metres.

    The metres are those of the first map.
    """
    places, world = [], rows[0][0].world
    for futures in (one for row in rows for one in row):
        shown = futures.mark_predicted()
        steps = slice(futures.start, futures.start + 1 + futures.states.shape[2])
        recorded = futures.scene.poses[shown, steps, :2]
        paths = futures.states[:, shown, :, :2].reshape(-1, 2), recorded.reshape(-1, 2)
        every = torch.cat(paths)
        here = every[torch.isfinite(every).all(dim=1)].double().cpu().numpy()
        if world is not None and futures.world is not None:
            here = change_world(futures.world, world, here)
        places.append(here)
    positions = np.concatenate(places)
    low, high = positions.min(axis=0), positions.max(axis=0)
    half = (high - low).max() / 2 + PANEL_MARGIN_M
    return np.stack([(low + high) / 2 - half, (low + high) / 2 + half])


def film_futures(futures: Futures) -> Iterator[UInt8[Array, "H W 3"]]:
    """Draw the futures step by step, all samples in one picture.

    Args:
        futures: the futures from `predict`.

    Yields:
        An RGB picture of even sides for each predicted step.
    """
    figure = _make_figure(futures)
    canvas, axes = FigureCanvasAgg(figure), figure.add_subplot()
    futures.scene.draw_ground(axes, futures.fit_limits().double().numpy())
    for step in range(futures.states.shape[2]):
        futures.draw_step(axes, step)
        later = (step + 1) * futures.dt
        axes.set_title(f"{later:.1f} s after {futures.time:g} s")
        if step == 0:
            add_scale_bar(axes)
            add_legend(axes)
        canvas.draw()  # type: ignore[no-untyped-call]
        rendered = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        yield rendered[..., :3].copy()
        for drawn in list(axes.collections):
            drawn.remove()


def _make_figure(futures: Futures) -> Figure:
    """Make a figure for the map and a legend on its right; of even sides in pixels."""
    low, high = futures.fit_limits()
    width, height = (PICTURE_INCHES * (high - low) / (high - low).max()).tolist()
    sides = [round(50 * side) / 50 for side in (width + BESIDE_INCHES, height + BELOW_INCHES)]
    return Figure(figsize=(sides[0], sides[1]), dpi=100, layout="constrained")


def write_futures(
    futures: Futures, path: str | os.PathLike[str], *, notes: Sequence[str] = ()
) -> None:
    """Write a CSV with a row for each sample, step and agent that is present in it.

    It begins with the comment lines of the tracks format (`# crs`, `# origin`), and one for each
    agent that is left out. Columns are sample, id, type, time (s), x, y (metres from that origin),
    heading (rad), speed (m/s).

    Args:
        futures: the futures from `predict`.
        path: path of the file.
        notes: further comment lines.
    """
    scene = futures.scene
    with atomic_write(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        file.write(format_world(futures.world or World(None)))
        for name, reason in futures.left_out.items():
            file.write(f"# left out: {json.dumps(name)}, {reason}\n")
        file.writelines(f"# {note}\n" for note in notes)
        for sample, future in enumerate(futures.states):  # a table of all takes much memory
            agent, step = torch.isfinite(future[..., 0]).nonzero().cpu().numpy().T
            values = future.double().cpu().numpy()[agent, step].round(4)
            table = pd.DataFrame(values, columns=["x", "y", "heading", "speed"])
            table.insert(0, "time", (futures.time + (step + 1) * futures.dt).round(3))
            table.insert(0, "type", np.array(scene.types, object)[agent])
            table.insert(0, "id", np.array(scene.ids, object)[agent])
            table.insert(0, "sample", sample)
            table.to_csv(file, index=False, header=sample == 0)
