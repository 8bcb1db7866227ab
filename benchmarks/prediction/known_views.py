"""What ground the models that come with the package know: views beyond their limit, by place."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy import ndarray as Array

from benchmarks.prediction import sind, songdo
from benchmarks.prediction.places import (
    NEW_CAMPUS,
    NEW_PARKS,
    NEW_ROADS,
    Places,
    make_place_scene,
    make_places,
    misplace_map,
    read_map,
    read_recordings,
)
from benchmarks.prediction.real_places import STANFORD_TEST, read_stanford
from benchmarks.prediction.results import Workspace
from benchmarks.results import describe_machine, write_json
from geoaim.base.errors import TracksError
from geoaim.base.files import atomic_files
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS, SEGMENT_STEPS
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.familiarity import measure_strangeness
from geoaim.prediction.itra import ITRA
from geoaim.prediction.predict import MAX_STRANGE_SHARE
from geoaim.prediction.segments import control_present
from geoaim.rendering.scene import Scene

# kinds of places that a model was trained on, at places that it has not seen; and other kinds
KNOWN: Mapping[str, Places] = {
    "vehicle": (*NEW_ROADS, *NEW_CAMPUS),
    "pedestrian": (*NEW_ROADS, *NEW_PARKS),
}
OTHER: Mapping[str, Places] = {"vehicle": (), "pedestrian": NEW_CAMPUS}
AWAY_M, WRONG_SCALE = 40.0, 2.0  # wrong georeferences
Row = dict[str, str | float]


def run(workspace: Workspace) -> list[Path]:
    """Count views beyond the limit of known views, and warnings, by sort of place."""
    rows: list[Row] = []
    for number, kind in enumerate(KNOWN):
        workspace.progress("measure", number, len(KNOWN))
        model = read_pretrained(kind)
        if model.known_views is None:  # trained before models learned what they know
            continue
        for name, scenes in _list_cases(model, workspace).items():
            rows.append({"agents": f"{kind}s", "where": name, **measure(model, scenes)})
    paths = [workspace.results / f"known_views{suffix}" for suffix in (".json", ".md")]
    command = "python -m benchmarks.prediction known_views"
    with atomic_files(*paths) as parts:
        content = {"command": command, "machine": describe_machine(), "rows": rows}
        write_json(content, parts[0])
        parts[1].write_text(_format(command, rows), encoding="utf-8")
    return paths


def measure(model: ITRA, scenes: Sequence[Scene]) -> Row:
    """Measure the views of the agents that a model may predict, once in each of their segments.

    Args:
        model: a model that knows its views.
        scenes: recordings.

    Returns:
        The share of views beyond the limit, the median distance, and the share of times at which
        `predict` would warn.
    """
    config = model.config
    found: list[Array] = []  # distances at each time
    for scene in scenes:
        steps = SEGMENT_STEPS[config.kind]
        try:
            segments = cut_segments(scene, config.kind, steps=steps, stride=2 * steps, joint=True)
        except TracksError:
            continue
        segments = control_present(segments, slice(MAX_HISTORY_STEPS - 1, MAX_HISTORY_STEPS))
        distances = measure_strangeness(model, segments, scene.ground, step=MAX_HISTORY_STEPS - 1)
        if distances is not None:
            ends = segments.controlled.sum(dim=1).cumsum(dim=0)[:-1]
            found += np.split(distances.numpy(), ends.numpy())
    every = np.concatenate(found)
    warned = [np.mean(one > 1) > MAX_STRANGE_SHARE for one in found if len(one)]
    return {
        "views": len(every),
        "beyond": round(float(np.mean(every > 1)), 3),
        "median": round(float(np.median(every)), 2),
        "times": len(warned),
        "warned": round(float(np.mean(warned)), 3),
    }


def _list_cases(model: ITRA, workspace: Workspace) -> dict[str, list[Scene]]:
    """Scenes by sort of place and map."""
    kind, dt = model.config.kind, model.config.dt
    known, other = (
        make_places(workspace.places, places[kind], progress=workspace.progress)
        for places in (KNOWN, OTHER)
    )

    def make(places: Sequence[Path], name: str = "aim") -> list[Scene]:
        return [scene for place in places for scene in _make_scenes(place, name, dt)]

    cases = {"places of trained kinds": make(known)}
    if other:
        cases["places of another kind"] = make(other)
    for name in ("degraded", "another day", "hdm"):
        cases[f"trained kinds, map {name}"] = make(known, name)
    for name in ("away", "scaled", "none"):
        cases[f"trained kinds, map {name}"] = make(known, name)
    return cases | _list_real(model)


def _list_real(model: ITRA) -> dict[str, list[Scene]]:
    """Scenes of real places, by data set."""
    if model.config.kind == "vehicle":
        return {"Songdo": [songdo.read_scene()]}
    stanford = [one for place in STANFORD_TEST for one in read_stanford(place)]
    scenes = [recording.make_scene(model.config.dt) for recording in stanford]
    return {"Stanford": scenes, "SinD": sind.read_scenes()}


def _make_scenes(place: Path, name: str, dt: float) -> Iterator[Scene]:
    wrong = name in ("away", "scaled")
    aim = read_map(place, "aim" if wrong else name)
    if name == "away":
        aim = misplace_map(aim, shift=AWAY_M)
    if name == "scaled":
        aim = misplace_map(aim, scale=WRONG_SCALE)
    for recording in read_recordings(place)[:1]:
        yield make_place_scene(recording, aim, dt=dt)


def _format(command: str, rows: Sequence[Row]) -> str:
    names = ("agents", "where", "views", "beyond", "median", "times", "warned")
    lines = [f"`{command}`", "", "| agents | where | views | beyond the limit | median distance | "]
    lines[-1] += "times | warned |"
    lines.append("|" + " --- |" * len(names))
    lines += [f"| {' | '.join(str(row[name]) for name in names)} |" for row in rows]
    return "\n".join(lines) + "\n"
