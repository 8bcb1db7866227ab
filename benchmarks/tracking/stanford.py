"""Real people and cyclists: Stanford boxes at 10 Hz, tracked without their ids.

    GEOAIM_DATA=... python -m benchmarks.tracking.stanford

The boxes are the annotations, of which most are interpolated, so that they have no noise and no
misses: what is compared is association alone. Videos were annotated in parts of 500 frames, which
reach 31 frames into the next one; there many agents get another number, or have two. So the time
between these frames is judged as well, each part tracked alone.
"""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import typer

from benchmarks.data import require_data
from benchmarks.realism.motion import read_sdd_resolutions
from benchmarks.results import JsonFile, print_rows, write_rows
from benchmarks.tracking.peers import list_peers
from benchmarks.tracking.real import match_states
from benchmarks.tracking.scores import compute_idf1, judge_gaps
from geoaim.base.world import World
from geoaim.mapping.video.detections import DetectedBoxes, map_classes
from geoaim.tracking import track_boxes
from geoaim.tracks.formats.stanford import BOX, COLUMNS
from geoaim.tracks.tracks import Tracks

FOLDER = "tracks/sdd_raw"
SCENES = "hyang/video7", "gates/video6", "nexus/video10"
TYPES = {"Biker": "cyclist", "Pedestrian": "pedestrian", "Cart": "car", "Skater": "pedestrian"}
STRIDE, RATE, SECONDS = 3, 10.0, 60.0
MAX_DISTANCE_M = 2.0  # at the border annotations are cut off, and our boxes are completed
PART, SHARED = 500, 32  # frames of a part that was annotated at once, and of the one before in it


def measure_scene(path: Path, resolution: float) -> list[dict[str, Any]]:
    """Measure all trackers on a minute of a scene; a row for each."""
    table = pd.read_csv(path, sep=" ", header=None, names=list(COLUMNS))
    table = table[(table["lost"] == 0) & (table["frame"] % STRIDE == 0)]
    table = table.assign(step=table["frame"] // STRIDE)
    table = table[table["step"] < RATE * SECONDS]
    size = int(table["bottom"].max()) + 1, int(table["right"].max()) + 1
    once = table[(table["frame"] < PART) | (table["frame"] % PART >= SHARED)]
    parts = [part for _, part in once.groupby(once["frame"] // PART)]
    rows = []
    for name, tracker in {"geoaim": track_boxes, **list_peers()}.items():
        whole, alone = (
            _score_parts([_track(part, tracker, size, resolution) for part in given])
            for given in ([table], parts)
        )
        rows.append({"method": name} | whole | {"IDF1 between hand-overs": alone["IDF1"]})
    return rows


def _track(
    table: pd.DataFrame, tracker: Any, size: tuple[int, int], resolution: float
) -> tuple[Tracks, Tracks]:
    """Track boxes; the agents themselves, and what was found."""
    table = table.assign(step=table["step"] - table["step"].min())
    count, world = int(table["step"].max()) + 1, World(None)
    times = np.arange(count) / RATE
    matrix = np.array([[resolution, 0, 0], [0, -resolution, size[0] * resolution], [0, 0, 1]])
    boxes = []
    for step in range(count):
        rows = table[table["step"] == step]
        kinds = [TYPES.get(label, label) for label in rows["label"]]
        sides = rows[list(BOX)].to_numpy(np.float64)
        boxes.append(DetectedBoxes(sides, types=map_classes(kinds)))
    found = tracker(boxes, np.tile(matrix, (count, 1, 1)), times, world, size)
    found = found if isinstance(found, Tracks) else found.tracks
    return _make_truth(table, times, matrix, world), found


def _make_truth(table: pd.DataFrame, times: Any, matrix: Any, world: World) -> Tracks:
    numbers, ids = pd.factorize(table["id"])
    states = np.full((len(ids), len(times), 4), np.nan)
    middle = np.column_stack(
        [table["left"] + table["right"], table["top"] + table["bottom"], np.full(len(table), 2.0)]
    )
    states[numbers, table["step"], :2] = (middle / 2 @ matrix.T)[:, :2]
    present = np.isfinite(states[..., 0])
    states[present, 2:] = 0.0
    names = tuple(map(str, ids))
    kinds = ("pedestrian",) * len(ids)
    return Tracks(times, states, present, np.ones((len(ids), 2)), kinds, names, world)


def _score_parts(parts: list[tuple[Tracks, Tracks]]) -> dict[str, Any]:
    """Score parts that share no agent."""
    agree, boxes, counts, gaps = 0.0, 0, np.zeros(2, int), Counter[str]()
    for own, found in parts:
        pairs, _ = match_states(own, found, MAX_DISTANCE_M)
        shared = np.zeros((len(own.ids), len(found.ids)))
        np.add.at(shared, tuple(pairs[:, :2].T), 1)
        count = int(own.present.sum() + found.present.sum())
        agree += compute_idf1(shared, count) * count
        boxes += count
        counts += shared.shape
        gaps.update(judge_gaps(found, pairs, np.ones(len(found.ids), bool)))
    return {"agents": int(counts[0]), "tracks": int(counts[1]), "IDF1": agree / boxes} | gaps


def main(json: JsonFile = None) -> None:
    """Measure tracks of annotated boxes at 10 Hz."""
    folder = require_data(FOLDER)
    scales = read_sdd_resolutions(folder / "estimated_scales.yaml")
    rows = print_rows(
        {"scene": scene} | row
        for scene in SCENES
        for place, video in [scene.split("/")]
        for row in measure_scene(folder / scene / "annotations.txt.gz", scales[place, video])
    )
    write_rows(rows, json, command="python -m benchmarks.tracking.stanford")


if __name__ == "__main__":
    typer.run(main)
