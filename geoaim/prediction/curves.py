"""How a training went, as a picture: its losses and what was measured on the way."""

import os
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from geoaim.files import write_figure


def write_curves(log: str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Draw a training's `log.csv` as a PNG: a panel for each loss and for minADE, by steps."""
    table = pd.read_csv(Path(log)).set_index("step")
    names = {
        "fit": "fit, sigmas² / 2",
        "divergence": "divergence of latents, nats",
        "plan": "plans that learn, m",
        "minADE": "minADE of what is held out, m",
    }
    shown = [name for name in names if table[name].any()]
    figure = Figure(figsize=(4 * len(shown), 3), layout="constrained")
    for axes, name in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
        axes.plot(table.index, table[name], ".-", color="#ff6a00")
        axes.set(title=names[name], xlabel="steps")
        axes.set_yscale("log" if name == "fit" else "linear")
        axes.grid(alpha=0.3)
    write_figure(figure, path)
