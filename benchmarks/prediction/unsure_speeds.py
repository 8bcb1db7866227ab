"""How errors of predictions grow with the uncertainty of the speed from which they start.

The speeds of all predicted agents are disturbed by normal noise that lasts over what is observed,
as the error of a filtered speed does. The exact futures are the truth.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from benchmarks.prediction.places import make_drawn_scene
from benchmarks.prediction.results import Workspace
from benchmarks.results import describe_machine, write_json
from benchmarks.synthetic.roads.layouts import PlaceKind
from geoaim.base.defaults import SAMPLES
from geoaim.base.files import atomic_files
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS, SEGMENT_STEPS
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import compute_ade, select_agents_to_judge
from geoaim.prediction.segments import Segments, pick
from geoaim.rendering.prefiltering import prefilter_ground

PLACES: Sequence[tuple[PlaceKind, int]] = (("junction", 431), ("roundabout", 432), ("park", 433))
SIGMAS = (0.0, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0, 4.0)  # m/s
SPEEDS = {  # ranges of true speeds, m/s
    "vehicle": ((0.0, 0.5), (0.5, 4.0), (4.0, 9.0), (9.0, np.inf)),
    "pedestrian": ((0.0, 0.5), (0.5, np.inf)),
}
MINUTES = 1.0
MAX_SEGMENTS = 6  # of each place, at even intervals
MIN_AGENTS = 10  # a row of fewer tells nothing
Row = dict[str, str | float]


def run(workspace: Workspace) -> list[Path]:
    """Measure errors by the uncertainty of speeds, on drawn places; return the files."""
    rows: list[Row] = []
    for kind, ranges in SPEEDS.items():
        model, found = read_pretrained(kind), []
        for number, (layout, seed) in enumerate(PLACES):
            workspace.progress(f"{kind}s", number, len(PLACES))
            found.append(_measure(model, layout, seed))
        speeds, errors = (torch.cat(parts, dim=-1) for parts in zip(*found, strict=True))
        for low, high in ranges:
            inside = (speeds >= low) & (speeds < high)
            if inside.sum() < MIN_AGENTS:
                continue
            means = errors[:, inside].mean(dim=1).tolist()
            text = f"{low:g} to {high:g} m/s" if np.isfinite(high) else f"over {low:g} m/s"
            row: Row = {"agents": f"{int(inside.sum())} {kind}s, {text}"}
            pairs = zip(SIGMAS, means, strict=True)
            rows.append(row | {f"{sigma:g} m/s": round(mean, 2) for sigma, mean in pairs})
    paths = [workspace.results / f"unsure_speeds{suffix}" for suffix in (".json", ".md")]
    command = "python -m benchmarks.prediction unsure_speeds"
    with atomic_files(*paths) as parts:
        content = {"command": command, "machine": describe_machine(), "places": PLACES}
        write_json(content | {"metric": "mean ADE of 6 samples, m", "rows": rows}, parts[0])
        lines = [f"`{command}`", "", f"| {' | '.join(rows[0])} |", "|" + " --- |" * len(rows[0])]
        lines += [f"| {' | '.join(str(value) for value in row.values())} |" for row in rows]
        parts[1].write_text("\n".join(lines) + "\n", encoding="utf-8")
    return paths


def _measure(
    model: ITRA, layout: PlaceKind, seed: int
) -> tuple[Float[Tensor, "E"], Float[Tensor, "s E"]]:
    """Speeds of a place's agents, and their mean errors by the deviation of the noise, m."""
    kind = model.config.kind
    scene, _ = make_drawn_scene(layout, seed, minutes=MINUTES, dt=model.config.dt)
    steps = SEGMENT_STEPS[kind]
    segments = cut_segments(scene, kind, steps=steps, stride=steps, joint=True)
    segments = pick(segments, slice(None, None, -(-len(segments) // MAX_SEGMENTS)))
    ground = prefilter_ground(scene.ground, model.config.resolution)
    judged = select_agents_to_judge(segments, MAX_HISTORY_STEPS)
    speeds = segments.states[:, :, MAX_HISTORY_STEPS - 1, 3].abs()
    errors = []
    for sigma in SIGMAS:
        noisy = _disturb(segments, sigma)
        futures = model.sample(
            noisy,
            ground,
            history=MAX_HISTORY_STEPS,
            samples=SAMPLES,
            generator=torch.Generator().manual_seed(seed),
        )
        errors.append(compute_ade(futures, segments, MAX_HISTORY_STEPS).mean(dim=1)[judged])
    return speeds[judged], torch.stack(errors)


def _disturb(segments: Segments, sigma: float) -> Segments:
    """Disturb the observed speeds of the agents that are predicted, by the same noise each time."""
    noise = torch.randn(segments.controlled.shape, generator=torch.Generator().manual_seed(0))
    states = segments.states.clone()
    states[:, :, :MAX_HISTORY_STEPS, 3] += (sigma * noise * segments.controlled)[..., None]
    return replace(segments, states=states)
