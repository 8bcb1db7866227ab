"""Memory over long work: 20,000 frames, 2,000 training steps, 10,000 rollouts.

    python -m tests.faults.long_runs -o docs/bench/long_runs.json

Each runs in a process of its own, on small frames and a tiny model, and is sampled at each percent.
The first tenth is warm-up; the mean of the second tenth is what the second half is compared with.
"""

import argparse
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np
import torch

from benchmarks.results import write_json
from geoaim.mapping.pipeline import build_aim
from geoaim.prediction.config import TrainConfig
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.training import init_model, train
from geoaim.simulation.idm import make_idm_policy
from geoaim.simulation.routes import extract_routes
from geoaim.simulation.simulator import Scenario, rollout
from tests.prediction.tiny import TINY, drive, hill

FRAMES, STEPS, ROLLOUTS = 20_000, 2_000, 10_000
HEIGHT, WIDTH, MARGIN = 120, 160, 8
TOLERANCE = 0.05  # of the memory
POINTS = "name,u,v,x,y,crs\n" + "".join(
    f"p{u}_{v},{u},{v},{583000 + u / 4},{6062000 - v / 4},EPSG:32635\n"
    for u in (4, 80, 156)
    for v in (4, 116)
)
Sample = Callable[[int], None]  # takes what is done


def build_map(folder: Path, count: int, sample: Sample) -> None:
    """Register and average the frames of a video of a camera that sways above a texture."""
    generator = np.random.default_rng(23)
    ground = generator.integers(0, 255, (HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN, 3), np.uint8)
    ground = cv2.normalize(cv2.GaussianBlur(ground, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
    with av.open(str(folder / "video.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for index in range(count):
            left, top = (int(MARGIN * (1 + f(index / 40))) for f in (np.sin, np.cos))
            part = np.ascontiguousarray(ground[top : top + HEIGHT, left : left + WIDTH])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(part, "rgb24")))
        container.mux(stream.encode())
    (folder / "points.csv").write_text(POINTS)
    build_aim(
        folder / "video.mp4",
        folder / "points.csv",
        frames="all",
        progress=lambda stage, done, total: sample(done),
    )


def train_model(folder: Path, count: int, sample: Sample) -> None:
    """Train a tiny model, with a validation and a checkpoint at each percent."""
    config = TrainConfig(
        steps=count, batch_size=2, history=(2, 4), checkpoint_interval=max(count // 100, 1)
    )
    dataset = Dataset(drive(10, 6), drive(10, 2, curve=-0.05), hill())
    train(
        init_model(TINY), config, dataset, folder, progress=lambda stage, done, total: sample(done)
    )


def simulate(folder: Path, count: int, sample: Sample) -> None:
    """Roll a scenario of three cars and three pedestrians out, over and over."""
    segments = drive(12, 1)
    states = segments.states.repeat(1, 3, 1, 1) + torch.arange(6)[:, None, None] * torch.ones(4) * 3
    sizes, present = segments.sizes.repeat(1, 3, 1), segments.present.repeat(1, 3, 1)
    scenario = Scenario(states, present, sizes, sizes[..., 0] < 1, segments.dt)
    everyone = ~scenario.pedestrian
    given = extract_routes(scenario), scenario.states[:, :, 0, 3], sizes, everyone
    policy = make_idm_policy(*given)
    for index in range(count):
        rollout(scenario, policy, everyone)
        sample(index + 1)


RUNS = {
    "build, frames": (build_map, FRAMES),
    "training, steps": (train_model, STEPS),
    "simulation, rollouts": (simulate, ROLLOUTS),
}


def measure_run(name: str, share: float = 1.0) -> dict[str, object]:
    """Memory over a run, or over a share of it.

    Args:
        name: of `RUNS`.
        share: of the work that is done.

    Returns:
        MB after the warm-up, over the second half, and the largest change between them.
    """
    work, full = RUNS[name]
    count, memory, began = round(full * share), {}, time.perf_counter()

    def sample(done: int) -> None:
        if done % max(count // 100, 1) == 0:
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            memory[done / count] = pages * 4096 / 1e6

    with tempfile.TemporaryDirectory() as folder:
        work(Path(folder), count, sample)
    before = float(np.mean([used for part, used in memory.items() if 0.1 < part <= 0.2]))
    later = [used for part, used in memory.items() if part > 0.5]
    change = max(later, key=lambda used: abs(used - before)) / before - 1.0
    return {
        "run": name,
        "done": count,
        "MB_after_warm-up": round(before, 1),
        "MB_least_in_second_half": round(min(later), 1),
        "MB_most_in_second_half": round(max(later), 1),
        "largest_change_%": round(100 * change, 2),
        "seconds": round(time.perf_counter() - began),
    }


def main() -> None:
    """Measure all runs, each in its own process; fail if the memory of one is not flat."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="JSON to write")
    parser.add_argument("--run", action="append", choices=list(RUNS), help="all if omitted")
    arguments = parser.parse_args()
    rows = []
    for name in arguments.run or RUNS:
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            rows.append(pool.apply(measure_run, (name,)))
        print(rows[-1], flush=True)
        command = "python -m tests.faults.long_runs -o docs/bench/long_runs.json"
        write_json({"command": command, "rows": rows}, arguments.output)
    sys.exit(any(abs(row["largest_change_%"]) > 100 * TOLERANCE for row in rows))


if __name__ == "__main__":
    main()
