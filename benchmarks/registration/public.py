"""A benchmark of registration that anybody can run: clips of hovering cameras, and their truth.

    python -m benchmarks.registration.public write clips
    python -m benchmarks.registration.public run clips --method geoaim -o mine
    python -m benchmarks.registration.public judge clips mine others --json result.json

`write` makes the clips from drawn places, without other data: H.264 videos, and beside each a table
`NAME.truth.csv` with a row for each frame: `index`, and `m00` to `m22`, the matrix from its pixels
to those of frame 0 (the corner of the image is 0, 0). A method gives a table `NAME.csv` of the same
form for each clip; a frame that it leaves out, or whose matrix is empty, is rejected.
"""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.hover_videos import Kind, film_place
from benchmarks.registration.methods import list_methods
from benchmarks.results import JsonFile, Row, print_rows, write_rows
from benchmarks.synthetic import reference_from_frames
from benchmarks.synthetic.roads.layouts import STANDARD_KINDS
from geoaim.base.encode import write_video
from geoaim.base.geometry import image_corners, transform_points
from geoaim.mapping.video.video import open_video

FRAMES = 120
RIGHT_PX = 0.3  # mean error of the corners up to which a frame is right
# by name: what disturbs the clip, and Mbit/s; None: a constant quality
HARD: dict[str, tuple[Kind, float | None]] = {
    "plain": ("plain", None),
    "low bit rate": ("plain", 1.0),
    "shadow": ("shadow", None),
    "gain": ("gain", None),
}
MATRIX = [f"m{row}{column}" for row in range(3) for column in range(3)]

app = typer.Typer(help=__doc__, no_args_is_help=True)
Folder = Annotated[Path, typer.Argument(help="folder of the clips")]


@app.command()
def write(
    folder: Folder, size: Annotated[str, typer.Option(help="720p or 1080p")] = "720p"
) -> None:
    """Write the clips and their truth."""
    folder.mkdir(parents=True, exist_ok=True)
    for place in STANDARD_KINDS:
        video = film_place(place, size=size, count=FRAMES)
        truth = reference_from_frames(video.clip)
        for name, (kind, megabits) in HARD.items():
            path = folder / f"{place}, {name}.mp4"
            print(path)
            write_video(replace(video, kind=kind), path, megabits=megabits)
            _write_matrices(truth, path.with_suffix(".truth.csv"))


@app.command()
def run(
    folder: Folder,
    output: Annotated[Path, typer.Option("-o", "--output", help="folder of the tables")],
    method: Annotated[str, typer.Option(help="a name of `list_methods`")] = "geoaim",
) -> None:
    """Register the clips by one of the package's methods."""
    methods = list_methods()
    if method not in methods:
        raise typer.BadParameter(f"{method}: it is one of {', '.join(methods)}")
    register = methods[method]
    output.mkdir(parents=True, exist_ok=True)
    for path in sorted(folder.glob("*.mp4")):
        frames = [frame.image for frame in open_video(path)]
        matrices, _ = register(frames, [np.empty((0, 4))] * len(frames))
        _write_matrices(np.asarray(matrices), output / f"{path.stem}.csv")


@app.command()
def judge(
    folder: Folder,
    methods: Annotated[list[Path], typer.Argument(help="folders of tables, one for each method")],
    json: JsonFile = None,
) -> None:
    """Judge the tables of methods: errors of the corners, frames that are right, rejected ones."""
    rows = [_judge(folder, tables, name) for tables in methods for name in HARD]
    write_rows(print_rows(rows), json, command="python -m benchmarks.registration.public")


def _judge(folder: Path, tables: Path, name: str) -> Row:
    """Judge the tables of a method on all clips with a difficulty."""
    clips = sorted(folder.glob(f"*, {name}.mp4"))
    errors = np.concatenate([_measure_errors(path, tables) for path in clips])
    known = errors[np.isfinite(errors)]
    shares = {
        "right, %": errors < RIGHT_PX,
        "wrong, %": errors >= RIGHT_PX,
        "rejected, %": np.isnan(errors),
    }
    return {
        "method": tables.name,
        "clips": name,
        "frames": len(errors),
        "median, px": round(float(np.median(known)), 4),
        "95 %, px": round(float(np.quantile(known, 0.95)), 4),
        **{title: round(100 * float(share.mean()), 1) for title, share in shares.items()},
    }


def _write_matrices(matrices: Float[Array, "T 3 3"], path: Path) -> None:
    table = pd.DataFrame(matrices.reshape(-1, 9), columns=MATRIX)
    table.to_csv(path, index_label="index")


def _measure_errors(path: Path, tables: Path) -> Float[Array, "T"]:
    """Mean distance of the corners from where they should be, px; NaN where a frame is rejected."""
    truth = pd.read_csv(path.with_suffix(".truth.csv"), index_col="index")
    given = pd.read_csv(tables / f"{path.stem}.csv", index_col="index")[MATRIX]
    given = given.reindex(truth.index)
    video = open_video(path)
    corners = image_corners(video.height, video.width)
    places = [
        transform_points(table.to_numpy().reshape(-1, 3, 3), corners) for table in (given, truth)
    ]
    errors = np.linalg.norm(places[0] - places[1], axis=2).mean(axis=1)
    return np.asarray(errors[1:])  # without the reference


if __name__ == "__main__":
    app()
