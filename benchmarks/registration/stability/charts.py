"""Tables and charts of a sweep: outcomes by level, breakpoints, stated uncertainty.

python -m benchmarks.registration.stability.charts build/stability/*.json -o build/stability
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from benchmarks.registration.stability.judge import (
    compare_methods,
    count_silent,
    find_best_ranks,
    measure_rejections,
    summarise,
)
from benchmarks.registration.stability.kinds import KINDS
from benchmarks.results import JsonFile, describe_machine, format_table, write_json
from geoaim.base.files import atomic_write

CASE = ["method", "kind", "rank", "level", "generator", "base", "size", "seed"]
# what a reader asks of a frame, with the verdicts that answer it and their colour
OUTCOMES = {
    "right": (("right",), "#009E73"),
    "refused": (("rejected",), "#DDDDDD"),
    "wrong, and said": (("wrong but uncertain",), "#56B4E9"),
    "wrong, and sure": (("understated", "wrong and overconfident"), "#000000"),
}


def write_cases(frames: pd.DataFrame, path: Path) -> None:
    """Write the judged frames as JSON, a row for each clip and method, with lists by frame."""
    frames = frames.assign(size=frames["size"].map(lambda size: f"{size[1]}x{size[0]}"))
    cases = frames.replace([np.inf, -np.inf], np.nan).groupby(CASE, sort=False).agg(list)
    with atomic_write(path) as part:
        cases.reset_index().to_json(part, orient="records", double_precision=4)


def read_cases(paths: list[Path]) -> pd.DataFrame:
    """Read files that `write_cases` wrote as one table with a row for each frame and method."""
    cases = pd.concat([pd.read_json(path) for path in paths], ignore_index=True)
    lists = [name for name in cases.columns if name not in CASE]
    frames = cases.explode(lists, ignore_index=True)
    numbers = ["error", "rms", "floor", "stated", "inlier_share", "seconds"]
    return frames.astype(dict.fromkeys(numbers, float))


def write_report(frames: pd.DataFrame, folder: Path, name: str) -> str:
    """Write the table and the charts of a sweep.

    Args:
        frames: rows of judged frames.
        folder: the folder to write to.
        name: name of the files, without suffix.

    Returns:
        The table, Markdown.
    """
    table = summarise(frames)
    silent = count_silent(frames)
    rejected = measure_rejections(frames, find_best_ranks(frames))
    lines = [
        format_table([dict(zip(table.columns, row, strict=True)) for row in table.to_numpy()]),
        "",
        f"{silent['frames']} frames, {silent['valid']} valid; silent failures: {silent['silent']} "
        f"({silent['share']:.2%}), of these {silent['far']} over 10 px; right frames rejected "
        f"below the best rival's breakpoint: {rejected:.2%}",
    ]
    text = "\n".join(lines)
    (folder / f"{name}.md").write_text(text + "\n", encoding="utf-8")
    draw_strips(frames).savefig(folder / f"{name}.png", dpi=100)
    return text


def draw_strips(frames: pd.DataFrame) -> Figure:
    """Draw what became of the frames of each kind by level, a column of strips for each method.

    A cell is a level, harmless on the left; its colours are the shares of its frames by outcome.
    The levels are written in the cells of the first method.
    """
    kinds = list(dict.fromkeys(frames.kind))
    methods = list(dict.fromkeys(frames.method))
    figure = Figure(figsize=(9, 0.24 * len(kinds) + 1), layout="constrained")
    panels = figure.subplots(
        1, len(methods), squeeze=False, width_ratios=[2] + [1] * (len(methods) - 1)
    )
    for axes, method in zip(panels[0], methods, strict=True):
        own = frames[frames.method == method]
        for row, kind in enumerate(kinds):
            _draw_strip(axes, own[own.kind == kind], row, has_levels=method == methods[0])
        axes.set(xlim=(0, 1), ylim=(len(kinds) - 0.5, -0.5), xticks=[])
        axes.set_title(method, fontsize=9)
        axes.set_yticks([])
        axes.set_frame_on(False)
    units = [f"{kind} ({KINDS[kind].unit})" for kind in kinds]
    panels[0, 0].set_yticks(range(len(kinds)), units, fontsize=8)
    panels[0, 0].tick_params(length=0)
    patches = [Patch(facecolor=colour, label=name) for name, (_, colour) in OUTCOMES.items()]
    figure.legend(handles=patches, loc="outside upper center", ncols=len(patches), fontsize=9)
    figure.supxlabel("each row: its levels, from harmless on the left to hopeless", fontsize=9)
    return figure


def _draw_strip(axes: Axes, frames: pd.DataFrame, row: int, *, has_levels: bool) -> None:
    """Draw the cells of one kind."""
    levels = frames.groupby("rank")
    width = 1 / len(levels)
    for number, (_, own) in enumerate(levels):
        left = number * width
        for verdicts, colour in OUTCOMES.values():
            share = 0.94 * width * float(own.verdict.isin(verdicts).mean())
            axes.barh(row, share, left=left, height=0.86, color=colour)
            left += share
        if has_levels:
            middle = (number + 0.47) * width
            level = np.format_float_positional(own.level.iloc[0], 2, fractional=False, trim="-")
            text = axes.text(middle, row, level, fontsize=6.5)
            text.set(
                ha="center", va="center", path_effects=[withStroke(linewidth=1.5, foreground="w")]
            )


def main(
    files: Annotated[list[Path], typer.Argument(help="JSON of sweeps, taken together")],
    output: Annotated[Path, typer.Option("-o", help="folder to write")] = Path("build/stability"),
    name: Annotated[str, typer.Option(help="of the split and of the files")] = "validation",
    json: JsonFile = None,
    command: Annotated[str, typer.Option(help="that made the sweep, for the JSON")] = "",
) -> None:
    """Write the table and the charts of finished sweeps, and the tables as JSON."""
    output.mkdir(parents=True, exist_ok=True)
    frames = read_cases(files)
    print(write_report(frames, output, name))
    if json is not None:
        content = {
            "command": command,
            "machine": describe_machine(),
            "clips": frames[frames.method == "geoaim"].groupby(CASE).ngroups,
            "methods": compare_methods(frames),
            "totals": count_silent(frames)
            | {
                "rejected_below_best_breakpoint": measure_rejections(
                    frames, find_best_ranks(frames)
                )
            },
            "rows": summarise(frames).to_dict("records"),
        }
        write_json(content, json)


if __name__ == "__main__":
    typer.run(main)
