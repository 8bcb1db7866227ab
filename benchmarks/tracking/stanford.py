"""Real people and cyclists: Stanford boxes at 10 Hz, tracked without their ids.

    GEOAIM_DATA=... python -m benchmarks.tracking.stanford

The boxes are the annotations, of which most are interpolated, so that they have no noise and no
misses: what is compared is association alone, against the floor of a plain filter.
"""

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
from benchmarks.tracking.scores import compute_idf1
from geoaim.base.world import World
from geoaim.mapping.video.detections import DetectedBoxes, map_classes
from geoaim.tracking import track_boxes
from geoaim.tracks.formats.stanford import BOX, COLUMNS
from geoaim.tracks.tracks import Tracks

FOLDER = "tracks/sdd_raw"
SCENES = "hyang/video7", "gates/video6", "nexus/video10"
TYPES = {"Biker": "cyclist", "Pedestrian": "pedestrian", "Cart": "car", "Skater": "pedestrian"}
STRIDE, RATE, SECONDS = 3, 10.0, 60.0


def measure_scene(path: Path, resolution: float) -> list[dict[str, Any]]:
    """Measure all trackers on a minute of a scene; a row for each."""
    table = pd.read_csv(path, sep=" ", header=None, names=list(COLUMNS))
    table = table[(table["lost"] == 0) & (table["frame"] % STRIDE == 0)]
    table = table.assign(step=table["frame"] // STRIDE)
    table = table[table["step"] < RATE * SECONDS]
    count = int(table["step"].max()) + 1
    size = int(table["bottom"].max()) + 1, int(table["right"].max()) + 1
    world = World(None)
    times = np.arange(count) / RATE
    matrix = np.array([[resolution, 0, 0], [0, -resolution, size[0] * resolution], [0, 0, 1]])
    boxes = []
    for step in range(count):
        rows = table[table["step"] == step]
        kinds = [TYPES.get(label, label) for label in rows["label"]]
        sides = rows[list(BOX)].to_numpy(np.float64)
        boxes.append(DetectedBoxes(sides, types=map_classes(kinds)))
    own = _make_truth(table, times, matrix, world)
    given = boxes, np.tile(matrix, (count, 1, 1)), times, world, size
    found: dict[str, Tracks] = {"geoaim": track_boxes(*given)}
    found |= {name: tracker(*given).tracks for name, tracker in list_peers().items()}
    return [{"method": name} | _score(own, tracks) for name, tracks in found.items()]


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


def _score(own: Tracks, found: Tracks) -> dict[str, Any]:
    pairs, _ = match_states(own, found, 1.0)
    shared = np.zeros((len(own.ids), len(found.ids)))
    np.add.at(shared, tuple(pairs.T), 1)
    idf1 = compute_idf1(shared, int(own.present.sum() + found.present.sum()))
    return {"agents": len(own.ids), "tracks": len(found.ids), "IDF1": idf1}


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
