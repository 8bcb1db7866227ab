"""Steering: whether agents reach the way points that they are given, and at what price.

    python -m benchmarks.prediction steering

Each vehicle that drives is sent to where its recording is 2 to 4 s later, at that time or a fifth
later, by the pretrained model with its braking. Places as in `reaction`: nothing was chosen on
them for steering.
"""

from pathlib import Path

import numpy as np
import torch

from benchmarks.prediction.places import make_drawn_scene
from benchmarks.prediction.reaction import SAMPLE, TEST, VAL, Row, write_rows
from benchmarks.prediction.results import Workspace
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import Metric, compute_metrics, concat
from geoaim.prediction.plans import Goal
from geoaim.prediction.segments import Segments, pick
from geoaim.rendering.ground import Ground
from geoaim.rendering.prefiltering import prefilter_ground

PLACES = {"sample": SAMPLE, "validation": VAL, "test": TEST}
HISTORY, HORIZON, STRIDE, FUTURES = MAX_HISTORY_STEPS, 60, 30, 6  # steps of 0.1 s
FIRST_S, LAST_S = 2.0, 4.0  # of the recorded way points
LATER = {"none": None, "as recorded": 1.0, "a fifth later": 1.2}  # times of way points
MIN_WAY_M, REACHED_M = 4.0, 2.0  # nearer way points are not given


def run(workspace: Workspace) -> list[Path]:
    """Send vehicles to way points; return the files."""
    model, rows = read_pretrained("vehicle"), []
    for name, places in PLACES.items():
        cases = []
        for seed, kind in places:
            workspace.progress(f"steering, {kind} {seed}", 0, None)
            scene, _ = make_drawn_scene(kind, seed)
            steps = HISTORY + HORIZON
            segments = cut_segments(scene, "vehicle", steps=steps, stride=STRIDE, joint=True)
            cases.append((segments, prefilter_ground(scene.ground, model.config.resolution)))
        for title, later in LATER.items():
            parts = [_measure(model, *case, later) for case in cases]
            found = concat(parts)
            row: Row = {"places": name, "way points": title}
            row |= {key: round(metric.mean, 4) for key, metric in found.items()}
            row["vehicles"] = int(found["reached"].counts.sum()) // FUTURES
            rows.append(row)
    return write_rows("steering", {"steering": rows}, workspace)


def _measure(
    model: ITRA, segments: Segments, ground: Ground, later: float | None
) -> dict[str, Metric]:
    """Share of futures that reach their way points, and the rate of collisions."""
    parts = []
    for number in range(len(segments)):
        one = pick(segments, slice(number, number + 1))
        draw = torch.Generator().manual_seed(number)
        seconds = FIRST_S + (LAST_S - FIRST_S) * torch.rand(one.agents, generator=draw)
        step = HISTORY - 1 + (seconds / one.dt).round().long()
        row = torch.arange(one.agents)
        goal = one.states[0, row, step, :2]
        there = one.controlled[0] & one.present[0, :, HISTORY - 1] & one.present[0, row, step]
        there &= (goal - one.states[0, :, HISTORY - 1, :2]).norm(dim=1) > MIN_WAY_M
        reached = HISTORY - 1 + ((step - HISTORY + 1) * (later or 1.0)).round().long()
        goals = {
            one.ids[0][k]: Goal(
                [tuple(goal[k].tolist())], [float(reached[k] - HISTORY + 1) * one.dt]
            )
            for k in there.nonzero()[:, 0].tolist()
            if later is not None
        }
        futures = model.sample(
            one, ground, history=HISTORY, samples=FUTURES, generator=draw, goals=goals
        )
        away = (futures[0, :, row, reached, :2] - goal).norm(dim=-1)[:, there]
        arrived = Metric(np.array([float((away < REACHED_M).sum())]), np.array([away.numel()]))
        collided = compute_metrics(futures, one, HISTORY)["collision rate"]
        parts.append({"reached": arrived, "collision rate": collided})
    return concat(parts)
