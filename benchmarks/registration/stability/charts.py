"""Tables and charts of a sweep: error against disturbance, breakpoints, stated uncertainty.

python -m benchmarks.registration.stability.charts build/stability/*.json -o build/stability
"""

from json import loads
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from matplotlib.figure import Figure

from benchmarks.registration.stability.judge import (
    MAX_RIGHT_ERROR_PX,
    VERDICTS,
    compare_methods,
    count_silent,
    find_best_ranks,
    is_of_rival,
    measure_rejections,
    read_best_ranks,
    summarise,
)
from benchmarks.results import JsonFile, describe_machine, format_table, write_json
from geoaim.base.files import atomic_write

CASE = ["method", "kind", "rank", "level", "generator", "base", "size", "seed"]
COLOURS = ("#009E73", "#DDDDDD", "#56B4E9", "#E69F00", "#000000")  # colours of the verdicts
# lines of the methods, this library first; colour-blind readers tell them apart by their dashes as
# well
LINES = (("#D55E00", "-"), ("#0072B2", "--"), ("#CC79A7", "-."), ("#009E73", ":"))
PANEL_COLUMNS = 7
SMALLEST_PX, LARGEST_PX = 0.003, 300.0  # limits of the charts' error axis


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
    for suffix in ("svg", "png"):
        draw_errors(frames).savefig(folder / f"{name}-errors.{suffix}", dpi=75)
        draw_verdicts(table).savefig(folder / f"{name}-verdicts.{suffix}", dpi=100)
    return text


def draw_errors(frames: pd.DataFrame) -> Figure:
    """Draw error against disturbance, a panel for each kind.

    Lines are medians over the frames that a method did not reject, bands reach to their 90th
    percentile, a mark's size is the share of frames not rejected, and the dotted line is what this
    library stated.
    """
    kinds = list(frames.kind.unique())
    columns = min(int(np.ceil(np.sqrt(len(kinds)))), PANEL_COLUMNS)
    rows = -(-len(kinds) // columns)
    figure = Figure(figsize=(3 * columns + 2, 2.2 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel, kind in zip(panels, kinds, strict=False):
        own = frames[frames.kind == kind]
        for number, (method, theirs) in enumerate(own.groupby("method", sort=False)):
            by_level = theirs.groupby("rank")
            error = by_level.error
            median, high = error.median(), error.quantile(0.9)
            share = by_level.error.apply(lambda e: e.notna().mean())
            colour, style = LINES[number % len(LINES)]
            panel.plot(median.index, median, style, color=colour, label=str(method))
            panel.scatter(median.index, median, 30 * share + 1, color=colour)
            panel.fill_between(median.index, median, high, color=colour, alpha=0.12)
            if method == "geoaim":
                stated = theirs[theirs.error.notna()].groupby("rank").stated.median()
                panel.plot(stated.index, stated, ":", color="black", label="stated by geoaim")
        levels = own.groupby("rank")["level"].first()
        panel.set_xticks(levels.index, [f"{level:g}" for level in levels], fontsize=7)
        panel.set(yscale="log", ylim=(SMALLEST_PX, LARGEST_PX))
        panel.set_title(kind, fontsize=8)
        panel.axhline(MAX_RIGHT_ERROR_PX, color="grey", linewidth=0.6)
    for panel in panels[len(kinds) :]:
        panel.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    figure.supylabel("largest error in the frame, px")
    return figure


def draw_verdicts(table: pd.DataFrame) -> Figure:
    """Draw the share of each verdict on this library's frames, a bar for each kind."""
    figure = Figure(figsize=(9, 0.22 * len(table) + 1.2), layout="constrained")
    axes = figure.subplots()
    left = np.zeros(len(table))
    for verdict, colour in zip(VERDICTS, COLOURS, strict=True):
        share = (table[verdict] / table.frames).to_numpy()
        axes.barh(table.kind, share, left=left, color=colour, label=verdict)
        left += share
    axes.invert_yaxis()
    axes.margins(y=0.01)
    axes.tick_params(labelsize=7)
    axes.set(xlim=(0, 1), xlabel="share of frames, all levels")
    figure.legend(loc="outside upper center", ncols=len(VERDICTS), fontsize=8)
    return figure


def main(
    files: Annotated[list[Path], typer.Argument(help="JSON of sweeps, taken together")],
    output: Annotated[Path, typer.Option("-o", help="folder to write")] = Path("build/stability"),
    name: Annotated[str, typer.Option(help="of the split and of the files")] = "validation",
    json: JsonFile = None,
    earlier: Annotated[
        Path | None, typer.Option(help="earlier JSON of the split, for the other methods")
    ] = None,
    command: Annotated[str, typer.Option(help="that made the sweep, for the JSON")] = "",
) -> None:
    """Write the table and the charts of finished sweeps, and the tables as JSON."""
    output.mkdir(parents=True, exist_ok=True)
    frames = read_cases(files)
    print(write_report(frames, output, name))
    if json is not None:
        methods, rows = compare_methods(frames), summarise(frames).to_dict("records")
        best_ranks = find_best_ranks(frames)
        if earlier is not None:
            known = loads(earlier.read_text(encoding="utf-8"))
            best_ranks = read_best_ranks(name, known["rows"])
            methods += [row for row in known["methods"] if row["method"] != "geoaim"]
            theirs = {row["kind"]: row for row in known["rows"]}
            for row in rows:
                known_of_kind = theirs.get(row["kind"], {})  # none of a newer kind
                row |= {key: v for key, v in known_of_kind.items() if is_of_rival(key)}
        content = {
            "command": command,
            "machine": describe_machine(),
            "clips": frames[frames.method == "geoaim"].groupby(CASE).ngroups,
            "methods": methods,
            "totals": count_silent(frames)
            | {"rejected_below_best_breakpoint": measure_rejections(frames, best_ranks)},
            "rows": rows,
        }
        write_json(content, json)


if __name__ == "__main__":
    typer.run(main)
