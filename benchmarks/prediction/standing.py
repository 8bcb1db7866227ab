"""Whether agents that stand stay where they are: futures of the pretrained models on the sample."""

from pathlib import Path

import torch

from benchmarks.prediction.results import Workspace
from benchmarks.results import describe_machine, write_json
from geoaim.base.files import atomic_files
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.mapping.pipeline import build_aim
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS
from geoaim.prediction.futures import Futures
from geoaim.prediction.itra import ITRA
from geoaim.prediction.predict import predict
from geoaim.rendering.scene import Scene, find_step, make_scene
from geoaim.tracks.changes import resample_tracks
from geoaim.tracks.formats import read_tracks
from geoaim.tracks.lights import read_lights

SAMPLE = Path("samples")  # of the repository, from whose root the experiment runs
TIMES = (5.0, 9.0, 11.0)  # s, last observed ones
HORIZONS = {"vehicle": 40, "pedestrian": 20}  # steps: 4 s and 8 s
FUTURES = 100
STILL_M = 0.3  # who moves by less, in the history and in the recorded future, stands
FAR_M = 1.0  # a future that leads further is counted
Row = dict[str, str | float]


def run(workspace: Workspace) -> list[Path]:
    """Count the futures in which agents that stand move by over 1 m; return the files."""
    aim = build_aim(SAMPLE / "hover.mp4", SAMPLE / "gcps.csv", progress=workspace.progress)
    tracks = read_tracks(SAMPLE / "tracks.csv")
    stop_lines = read_hdmap(SAMPLE / "map.osm", tracks.world).stop_lines
    lights = read_lights(SAMPLE / "lights.csv", stop_lines, tracks.world)
    rows: list[Row] = []
    for number, kind in enumerate(HORIZONS):
        workspace.progress("predict", number, len(HORIZONS))
        model = read_pretrained(kind)
        scene = make_scene(aim, resample_tracks(tracks, 1 / model.config.dt), lights)
        for time in TIMES:
            rows += measure_standing(model, scene, time)
    paths = [workspace.results / f"standing{suffix}" for suffix in (".json", ".md")]
    content = {"command": "python -m benchmarks.prediction standing", "machine": describe_machine()}
    with atomic_files(*paths) as parts:
        write_json({**content, "futures": FUTURES, "rows": rows}, parts[0])
        parts[1].write_text(_format(rows), encoding="utf-8")
    return paths


def measure_standing(model: ITRA, scene: Scene, time: float) -> list[Row]:
    """Measure how far sampled futures move the agents that stand before and after a time.

    Args:
        model: a model.
        scene: the recording, at the model's dt.
        time: last observed time, s.

    Returns:
        For each of these agents its kind and id, the number of futures that lead further than
        `FAR_M`, and the furthest distance, m.
    """
    futures = predict(
        model,
        scene,
        samples=FUTURES,
        horizon=HORIZONS[model.config.kind],
        start=find_step(scene, time),
        generator=torch.Generator().manual_seed(0),
    )
    start = scene.poses[:, futures.start, None, :2]
    moved = (futures.states[..., :2] - start).norm(dim=-1).amax(dim=2)  # (K, N)
    return [
        {
            "agents": model.config.kind,
            "time": time,
            "id": scene.ids[agent],
            "futures beyond 1 m": int((moved[:, agent] > FAR_M).sum()),
            "furthest, m": round(float(moved[:, agent].max()), 2),
        }
        for agent in futures.mark_predicted().nonzero()[:, 0].tolist()
        if _stands(futures, agent)
    ]


def _stands(futures: Futures, agent: int) -> bool:
    """Whether an agent stands in the observed steps and in all recorded steps of the futures."""
    scene, first = futures.scene, max(0, futures.start + 1 - MAX_HISTORY_STEPS)
    steps = slice(first, futures.start + 1 + futures.states.shape[2])
    known = scene.present[agent, steps]
    positions = scene.poses[agent, steps, :2][known]
    return float((positions - positions[0]).norm(dim=-1).max()) < STILL_M


def _format(rows: list[Row]) -> str:
    lines = [
        "`python -m benchmarks.prediction standing`",
        "",
        f"| agents | after, s | id | futures of {FUTURES} beyond 1 m | furthest, m |",
        "| --- | --- | --- | --- | --- |",
        *(f"| {' | '.join(str(value) for value in row.values())} |" for row in rows),
    ]
    return "\n".join(lines) + "\n"
