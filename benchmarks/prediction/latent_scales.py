"""How far latents may spread in samples: errors and standing agents at validation places."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

from benchmarks.prediction.places import make_places
from benchmarks.prediction.pretrained import VAL
from benchmarks.prediction.realistic import make_scenes
from benchmarks.prediction.results import Workspace
from benchmarks.prediction.standing import FAR_M
from benchmarks.results import describe_machine, write_json
from geoaim.base.defaults import SAMPLES
from geoaim.base.errors import TracksError
from geoaim.base.files import atomic_files
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS, SEGMENT_STEPS
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import compute_metrics
from geoaim.prediction.segments import Segments, control_present, pick
from geoaim.rendering.ground import Ground
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene

SCALES = (1.0, 0.8, 0.6)
STATES = ("exact", "noisy")  # of each place's scenes in turn
STILL_M = {"exact": 0.3, "noisy": 0.9}  # who moves by less in a segment stands
MAX_SEGMENTS = 4  # of each scene, at even intervals
Row = dict[str, str | float]
Piece = tuple[str, Segments, Ground]  # whether its states are exact or noisy; and its map


def run(workspace: Workspace) -> list[Path]:
    """Evaluate scales of the pretrained models' latents at validation places; return the files."""
    rows: list[Row] = []
    for kind in VAL:
        model = read_pretrained(kind)
        places = make_places(workspace.places, VAL[kind], progress=workspace.progress)
        scenes = make_scenes(places, model.config.dt, progress=workspace.progress)
        pieces = [
            piece for number, scene in enumerate(scenes) for piece in _cut(scene, number, model)
        ]
        for number, scale in enumerate(SCALES):
            workspace.progress(f"evaluate {kind}s", number, len(SCALES))
            model.config = replace(model.config, latent_scale=scale)
            rows += [
                {"agents": f"{kind}s", "scale": scale, "states": states, **_measure(model, some)}
                for states in STATES
                for some in [[piece for piece in pieces if piece[0] == states]]
            ]
    paths = [workspace.results / f"latent_scales{suffix}" for suffix in (".json", ".md")]
    command = "python -m benchmarks.prediction latent_scales"
    with atomic_files(*paths) as parts:
        content = {"command": command, "machine": describe_machine(), "places": VAL, "rows": rows}
        write_json(content, parts[0])
        parts[1].write_text(_format(command, rows), encoding="utf-8")
    return paths


def _cut(scene: Scene, number: int, model: ITRA) -> list[Piece]:
    """Segments of moving and of parked agents, jointly."""
    kind, ground = model.config.kind, prefilter_ground(scene.ground, model.config.resolution)
    steps, pieces = SEGMENT_STEPS[kind], []
    for parked in (False, True):
        try:
            segments = cut_segments(
                scene, kind, steps=steps, stride=steps, joint=True, parked=parked
            )
            segments = control_present(segments, slice(None))
        except TracksError:  # none is present for long enough
            continue
        every = -(-len(segments) // MAX_SEGMENTS)
        few = pick(segments, slice(None, None, every))
        pieces.append((STATES[number % len(STATES)], few, ground))
    return pieces


def _measure(model: ITRA, pieces: Sequence[Piece]) -> Row:
    """Errors of moving agents, and how many futures move those that stand by over `FAR_M`."""
    single, joint, far = [], [], []
    for states, segments, ground in pieces:
        futures = model.sample(
            segments,
            ground,
            history=MAX_HISTORY_STEPS,
            samples=SAMPLES,
            generator=torch.Generator().manual_seed(0),
        )
        positions = segments.states[..., :2]
        travel = (positions.amax(dim=2) - positions.amin(dim=2)).norm(dim=-1)
        still = segments.controlled & (travel < STILL_M[states])
        now = positions[:, None, :, MAX_HISTORY_STEPS - 1, None]
        moved = (futures[..., MAX_HISTORY_STEPS:, :2] - now).norm(dim=-1).amax(dim=-1)  # (B, K, N)
        far.append((moved > FAR_M).float().transpose(1, 2)[still].flatten())
        moving = replace(segments, controlled=segments.controlled & ~still)
        some = moving.controlled.any(dim=1)
        if some.any():
            metrics = compute_metrics(futures[some], pick(moving, some), MAX_HISTORY_STEPS)
            single.append(metrics["minADE"])
            joint.append(metrics["joint minADE"])
    errors = {
        name: sum(one.sums.sum() for one in found) / sum(one.counts.sum() for one in found)
        for name, found in {"minADE": single, "joint minADE": joint}.items()
    }
    rounded: Row = {name: round(float(value), 3) for name, value in errors.items()}
    return {
        **rounded,
        "standing agents beyond 1 m, %": round(100 * float(torch.cat(far).mean()), 2),
    }


def _format(command: str, rows: Sequence[Row]) -> str:
    lines = [f"`{command}`", "", f"| {' | '.join(rows[0])} |", "|" + " --- |" * len(rows[0])]
    lines += [f"| {' | '.join(str(value) for value in row.values())} |" for row in rows]
    return "\n".join(lines) + "\n"
