"""Real tracks: the boxes of Songdo's 4K frames, tracked without their ids, against its own metres.

    GEOAIM_DATA=... python -m benchmarks.tracking.real

The transforms of the frames and of the orthophoto are those of the dataset, so that the positions
share their errors: what is compared is association and smoothing.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import typer
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment

from benchmarks.data import require_data
from benchmarks.results import JsonFile, print_rows, write_rows
from geoaim.mapping.video.detections import read_detections
from geoaim.mapping.video.frames import Frame
from geoaim.tracking import track_boxes
from geoaim.tracking.report import find_unknown_headings
from geoaim.tracks.formats import read_geotrax
from geoaim.tracks.formats.geotrax import FRAME_RATE, PIXEL_COLUMNS, VEHICLE_CLASSES
from geoaim.tracks.tracks import Tracks

FOLDER, NAME = "tracks/songdo_u", "U_video_cut"
SIZE = (2160, 3840)
MAX_DISTANCE_M = 3.0  # of states that are compared
STRIDES = (1, 15)  # all frames, and two per second
STANDING_SPEED = 0.7  # m/s


def measure_songdo(folder: Path, stride: int = 1) -> dict[str, Any]:
    """Measure the tracks of Songdo's boxes, of every so many frames, against the dataset's own."""
    own = read_geotrax(folder / f"{NAME}.csv", crs="EPSG:5186")
    world_from_frame = _read_transforms(folder, own)
    columns = {"frame": "frame", "x": "u", "y": "v", "width": "du", "height": "dv"}
    read = read_detections(
        pd.read_csv(folder / f"{NAME}.txt", names=PIXEL_COLUMNS, usecols=range(14)),
        columns=columns,
        classes=[f"{number}={name}" for number, name in VEHICLE_CLASSES.items()],
        form="xywh",
        first=0,
    )
    times = np.arange(len(world_from_frame)) / FRAME_RATE
    own_count = _count_states(own, times[::stride])
    empty = np.broadcast_to(np.uint8(0), SIZE)
    boxes = [read(Frame(step, time, None, empty)) for step, time in enumerate(times.tolist())]
    boxes, world_from_frame, times = boxes[::stride], world_from_frame[::stride], times[::stride]
    found = track_boxes(boxes, world_from_frame, times, own.world, SIZE)
    pairs, distance = match_states(own, found, MAX_DISTANCE_M)
    frame = pd.DataFrame(pairs[:, :2], columns=["own", "found"])
    speeds = np.nanmax(np.abs(found.states[..., 3]), axis=1)
    alike = frame.value_counts().rename("count").reset_index()
    table = alike.pivot(index="own", columns="found", values="count").fillna(0).to_numpy()
    kept = table[linear_sum_assignment(-table)].sum()
    return {
        "frames per second": FRAME_RATE / stride,
        "vehicles": len(own.ids),
        "tracks": len(found.ids),
        "states": own_count,
        "matched %": 100 * len(distance) / own_count,
        "IDF1": float(2 * kept / (own_count + found.present.sum())),
        "position m": float(np.median(distance)),
        "position m 90 %": float(np.quantile(distance, 0.9)),
        "position m 99 %": float(np.quantile(distance, 0.99)),
        "vehicles in several tracks": int((frame.groupby("own")["found"].nunique() > 1).sum()),
        "tracks of several vehicles": int((frame.groupby("found")["own"].nunique() > 1).sum()),
        "standing": int((speeds < STANDING_SPEED).sum()),
        "heading unknown": int(find_unknown_headings(found).sum()),
    }


def _read_transforms(folder: Path, own: Tracks) -> Float[Array, "T 3 3"]:
    """Read the transforms of the frames to the plane of the tracks."""
    rows = np.loadtxt(folder / f"{NAME}_vid_transf.txt", delimiter=",")
    reference_from_frame = np.concatenate([np.eye(3)[None], rows[:, 1:].reshape(-1, 3, 3)])
    ortho_from_reference = np.loadtxt(folder / f"{NAME}_geo_transf.txt", delimiter=",")
    table = pd.read_csv(folder / f"{NAME}.csv")
    pixels = np.column_stack([table[["Ortho_X", "Ortho_Y"]], np.ones(len(table))])
    metres = table[["Local_X", "Local_Y"]].to_numpy() - own.world.origin
    fitted = np.linalg.lstsq(pixels, metres, rcond=None)[0].T
    world_from_ortho = np.vstack([fitted, [0, 0, 1]])
    return world_from_ortho @ ortho_from_reference.reshape(3, 3) @ reference_from_frame


def _count_states(own: Tracks, times: Float[Array, "T"]) -> int:
    steps = np.abs(own.times[:, None] - times).argmin(axis=0)
    return int(own.present[:, steps].sum())


def match_states(own: Tracks, found: Tracks, reach: float) -> tuple[Array, Float[Array, "m"]]:
    """Match states frame by frame within reach, m: rows of both and step; their distances, m."""
    pairs, distances = [], []
    for step, time in enumerate(found.times):
        there = int(np.abs(own.times - time).argmin())
        one, other = np.flatnonzero(own.present[:, there]), np.flatnonzero(found.present[:, step])
        offset = own.states[one, there, None, :2] - found.states[None, other, step, :2]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        rows, columns = linear_sum_assignment(np.minimum(distance, reach))
        near = distance[rows, columns] < reach
        steps = np.full(near.sum(), step)
        pairs.append(np.column_stack([one[rows[near]], other[columns[near]], steps]))
        distances.append(distance[rows, columns][near])
    return np.concatenate(pairs), np.concatenate(distances)


def main(json: JsonFile = None) -> None:
    """Measure tracks of real boxes."""
    folder = require_data(FOLDER)
    rows = print_rows(measure_songdo(folder, stride) for stride in STRIDES)
    write_rows(rows, json, command="python -m benchmarks.tracking.real")


if __name__ == "__main__":
    typer.run(main)
