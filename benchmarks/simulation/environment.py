"""Steps a second of the gymnasium environment with random actions, on one thread.

    python -m benchmarks.simulation.environment --json docs/bench/environment.json

The scene is the sample on its HD map, with 64 agents and the drivable area; ended episodes are
reset. Others replay, or are driven by the vehicle model of the package; an image of the view is
observed, or none. Processor time is counted, beside that of four sines as a yardstick.
"""

import time
from collections.abc import Callable, Mapping
from typing import Annotated, Any

import torch
import typer

from benchmarks.results import JsonFile, print_rows, time_medians, write_rows
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.prediction import make_traffic
from geoaim.rendering.ground import View
from geoaim.rendering.scene import make_scene
from geoaim.simulation.environment import DrivingEnv
from geoaim.simulation.road_rules import make_road_rules
from geoaim.tracks.files import read_plain_tracks

SLOW = 20  # times fewer steps are timed with images and with traffic


def make_sample_environment(**options: Any) -> DrivingEnv:
    """Make the environment of the sample, on a map drawn from its HD map."""
    tracks = read_plain_tracks("samples/tracks.csv")
    hdmap = read_hdmap("samples/map.osm", tracks.world)
    scene = make_scene(draw_hdmap(hdmap, resolution=0.5), tracks)
    return DrivingEnv(scene, make_road_rules(hdmap), **options)


def drive_random_steps(env: DrivingEnv, steps: int) -> None:
    """Drive by random actions; episodes that end are followed by others."""
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()


def _prepare(options: Mapping[str, Any], steps: int) -> Callable[[], None]:
    env = make_sample_environment(**options)
    env.reset(seed=0)
    env.action_space.seed(0)
    return lambda: drive_random_steps(env, steps)


def main(
    json: JsonFile = None,
    steps: Annotated[int, typer.Option(help="of each timing")] = 2000,
    repeats: Annotated[int, typer.Option(help="of each timing; the median counts")] = 9,
) -> None:
    """Time the steps; print a table and write JSON."""
    torch.set_num_threads(1)
    numbers = torch.ones(100)
    views = {"view": View(84, 84, 0.5)}
    parts: dict[str, tuple[Callable[[], Any], int]] = {
        "environment, random policy": (_prepare({}, steps), steps),
        "the same, 84 px image": (_prepare(views, steps // SLOW), steps // SLOW),
        "the same, others by itra": (
            _prepare({"traffic": make_traffic()}, steps // SLOW),
            steps // SLOW,
        ),
        "4 sines of 100 numbers": (lambda: [numbers.sin() for _ in range(4 * steps)], steps),
    }
    durations = time_medians([part for part, _ in parts.values()], repeats, time.process_time)
    rows: list[dict[str, Any]] = [
        {"part": name, "us_per_step": 1e6 * duration / count, "steps_per_s": count / duration}
        for (name, (_, count)), duration in zip(parts.items(), durations, strict=True)
    ]
    command = f"python -m benchmarks.simulation.environment --steps {steps} --repeats {repeats}"
    write_rows(print_rows(rows), json, command=command, torch=torch.__version__)


if __name__ == "__main__":
    typer.run(main)
