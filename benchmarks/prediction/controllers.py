"""What each rule outside the network brings, and the shape of the motion that comes of it.

    python -m benchmarks.prediction controllers

All are measured at places of validation: futures of 5 s of all vehicles together, who stands and
starts among them, and all vehicles driven for 20 s. `reaction` measures followers behind leaders.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from torch import Tensor

from benchmarks.prediction.places import Places, make_drawn_scene
from benchmarks.prediction.reaction import (
    CLOSED_STEPS,
    HARD_MPS2,
    HISTORY,
    count_infractions,
    drive_all,
    write_rows,
)
from benchmarks.prediction.results import Workspace
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.controllers import brake, follow, start
from geoaim.prediction.cutting import cut_scene, cut_segments
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import compute_metrics
from geoaim.prediction.segments import VEHICLE, Segments
from geoaim.rendering.ground import Ground
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene, slice_scene
from geoaim.simulation.road_rules import RoadRules
from geoaim.simulation.simulator import apply_rollout

PLACES: Places = ((811, "junction"), (812, "t"), (813, "street"), (814, "roundabout"))
VARIANTS: Mapping[str, Sequence[Callable[..., Any]]] = {
    "all rules": (follow, start, brake),
    "without start": (follow, brake),
    "without brake": (follow, start),
    "networks alone": (follow,),
}
PREDICTED, FUTURES = 50, 6  # steps of 0.1 s; futures of each piece
STILL_M, STARTED_M = 0.3, 1.0  # who moves by less stands; by more has started
Sums = dict[str, Float[Array, "2"]]  # a sum and a count of each quantity


def run(workspace: Workspace) -> list[Path]:
    """Measure the pretrained vehicle model with and without each of its rules; return the files."""
    models = {}
    for name, controllers in VARIANTS.items():
        models[name] = read_pretrained("vehicle")
        models[name].controllers = list(controllers)
    rows = measure_models(models, PLACES, workspace)
    return write_rows("controllers", {"validation places": rows}, workspace)


def measure_models(
    models: Mapping[str, ITRA], places: Places, workspace: Workspace
) -> list[dict[str, Any]]:
    """Measure models at places; gives a row for each, and one of the recording.

    Of one model each quantity has its mean over all places and, in brackets, the lowest and the
    highest mean of one place.
    """
    found: dict[str, list[Sums]] = {}
    for seed, kind in places:
        workspace.progress(f"rules, {kind} {seed}", 0, None)
        scene, rules = make_drawn_scene(kind, seed)
        for name, sums in measure_place(models, scene, rules).items():
            found.setdefault(name, []).append(sums)
    return [{"driver": name, **_summarise(parts)} for name, parts in found.items()]


def measure_place(models: Mapping[str, ITRA], scene: Scene, rules: RoadRules) -> dict[str, Sums]:
    """Measure models at one place, and the recording."""
    ground = prefilter_ground(scene.ground, next(iter(models.values())).config.resolution)
    steps = HISTORY + PREDICTED
    pieces = cut_segments(scene, "vehicle", steps=steps, stride=steps, joint=True)
    loops = _cut_loops(scene)
    found = {
        name: _measure_futures(model, pieces, ground)
        | _measure_loops([(*loop, drive_all(model, loop[1], ground, 0)) for loop in loops], rules)
        for name, model in models.items()
    }
    recorded = [(piece, one, one.states[0]) for piece, one in loops]
    return {**found, "recording": _measure_loops(recorded, rules)}


def measure_starts(
    futures: Float[Tensor, "B K N T 4"], segments: Segments
) -> tuple[Bool[Tensor, "B K N"], Float[Tensor, "B K N"], Float[Tensor, "B N"]]:
    """Who has moved by `STARTED_M` in each future; how far; and how far as recorded, m.

    The recorded way is NaN unless an agent stands in the observed steps and is there to the end.
    """
    path = segments.states[..., :2]
    whole = segments.present.all(dim=2) & segments.controlled
    stood = (path[:, :, :HISTORY] - path[:, :, HISTORY - 1, None]).norm(dim=3).amax(dim=2) < STILL_M
    start_at = path[:, :, HISTORY - 1, None]
    recorded = (path[:, :, HISTORY:] - start_at).norm(dim=3).amax(dim=2)
    way = (futures[..., HISTORY:, :2] - start_at[:, None]).norm(dim=4).amax(dim=3)
    return way > STARTED_M, way, torch.where(whole & stood, recorded, torch.nan)


def _measure_futures(model: ITRA, segments: Segments, ground: Ground) -> Sums:
    generator = torch.Generator().manual_seed(0)
    parked = (segments.layers == VEHICLE) & segments.present.all(dim=2)
    every = replace(segments, controlled=segments.controlled | parked)
    futures = model.sample(every, ground, history=HISTORY, samples=FUTURES, generator=generator)
    metrics = compute_metrics(futures, segments, HISTORY)
    sums = {
        f"{name}, m": np.array([metrics[name].sums.sum(), metrics[name].counts.sum()])
        for name in ("minADE", "joint minADE")
    }
    gone, way, recorded = measure_starts(futures, every)
    starts, stays = recorded > STARTED_M, recorded < STILL_M
    sums["starters that start, %"] = _share(gone.transpose(1, 2)[starts])
    sums["their way, of the recorded"] = np.array(
        [float(way.mean(dim=1)[starts].sum()), float(recorded[starts].sum())]
    )
    sums["stayers that move, %"] = _share(gone.transpose(1, 2)[stays])
    return sums


def _cut_loops(scene: Scene) -> list[tuple[Scene, Segments]]:
    length = HISTORY + CLOSED_STEPS
    firsts = range(0, len(scene.times) - length + 1, CLOSED_STEPS)
    pieces = [slice_scene(scene, slice(first, first + length)) for first in firsts]
    segments = [cut_scene(piece, "vehicle") for piece in pieces]
    known = [piece.present & torch.isfinite(piece.observed).all(dim=2) for piece in pieces]
    seen = [replace(piece, present=one) for piece, one in zip(pieces, known, strict=True)]
    return list(zip(seen, segments, strict=True))


def _measure_loops(
    driven: Sequence[tuple[Scene, Segments, Float[Tensor, "N T 4"]]], rules: RoadRules
) -> Sums:
    """Infractions, jerk and hard braking of all vehicles in closed loop."""
    sums: Sums = {}
    jerks, brakings = [], []
    for piece, segment, states in driven:
        index = torch.tensor([piece.ids.index(name) for name in segment.ids[0]])
        agents = torch.zeros(len(piece.ids), dtype=torch.bool)
        agents[index] = segment.controlled[0]
        poses = torch.full((len(piece.ids), states.shape[1], 4), torch.nan)
        poses[index] = states
        for key, (total, number) in count_infractions(
            apply_rollout(piece, poses, 0), agents, rules
        ).items():
            sums[key] = sums.get(key, np.zeros(2)) + np.array([total, number])
        moved = segment.controlled[0]
        speeds = states[moved, HISTORY - 1 :, 3]
        there = segment.present[0, moved, HISTORY - 1 :].unfold(1, 3, 1).all(dim=2)
        rates = speeds.diff(dim=1) / segment.dt
        jerks.append((rates.diff(dim=1) / segment.dt)[there])
        brakings.append((rates[:, 1:] < -HARD_MPS2)[there])
    low, high = torch.quantile(torch.cat(jerks), torch.tensor([0.05, 0.95])).tolist()
    sums["jerk of 5 %, m/s³"] = np.array([low, 1.0])
    sums["jerk of 95 %, m/s³"] = np.array([high, 1.0])
    sums[f"steps with braking over {HARD_MPS2:g} m/s², %"] = _share(torch.cat(brakings))
    return sums


def _share(marks: Bool[Tensor, "..."]) -> Float[Array, "2"]:
    return np.array([100 * float(marks.sum()), marks.numel()])


def _summarise(parts: Sequence[Sums]) -> dict[str, str]:
    """The mean of each quantity over places, and the lowest and highest of one place."""
    cells = {}
    for key in dict.fromkeys(key for part in parts for key in part):
        some = np.array([part[key] for part in parts if key in part and part[key][1]])
        if not len(some):
            continue
        each, (total, count) = some[:, 0] / some[:, 1], some.sum(axis=0)
        cells[key] = f"{total / count:.3g} ({each.min():.3g} to {each.max():.3g})"
    return cells
