"""Steps a second of the gymnasium environment with a random policy, on one thread.

    python -m benchmarks.simulation.environment --json docs/bench/environment.json

The scene is the sample on its HD map, with 64 agents and the drivable area; ended episodes are
reset. Processor time is counted, beside that of four sines of as many numbers as a yardstick.
"""

import time
from collections.abc import Callable
from typing import Annotated, Any

import torch
import typer

from benchmarks.results import JsonFile, print_rows, time_medians, write_rows
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.rendering.scene import make_scene
from geoaim.simulation.environment import DrivingEnv
from geoaim.simulation.road_rules import make_road_rules
from geoaim.tracks.files import read_plain_tracks


def make_sample_environment() -> DrivingEnv:
    """Make the environment of the sample, on a map drawn from its HD map."""
    tracks = read_plain_tracks("samples/tracks.csv")
    hdmap = read_hdmap("samples/map.osm", tracks.world)
    scene = make_scene(draw_hdmap(hdmap, resolution=0.5), tracks)
    return DrivingEnv(scene, make_road_rules(hdmap))


def drive_random_steps(env: DrivingEnv, steps: int) -> None:
    """Drive by random actions; episodes that end are followed by others."""
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()


def main(
    json: JsonFile = None,
    steps: Annotated[int, typer.Option(help="of each timing")] = 2000,
    repeats: Annotated[int, typer.Option(help="of each timing; the median counts")] = 9,
) -> None:
    """Time the steps; print a table and write JSON."""
    torch.set_num_threads(1)
    env = make_sample_environment()
    env.reset(seed=0)
    env.action_space.seed(0)
    numbers = torch.ones(100)
    parts: list[Callable[[], Any]] = [
        lambda: drive_random_steps(env, steps),
        lambda: [numbers.sin() for _ in range(4 * steps)],
    ]
    durations = time_medians(parts, repeats, time.process_time)
    names = ("environment, random policy", "4 sines of 100 numbers")
    rows: list[dict[str, Any]] = [
        {"part": name, "us_per_step": 1e6 * duration / steps, "steps_per_s": steps / duration}
        for name, duration in zip(names, durations, strict=True)
    ]
    command = f"python -m benchmarks.simulation.environment --steps {steps} --repeats {repeats}"
    write_rows(print_rows(rows), json, command=command, torch=torch.__version__)


if __name__ == "__main__":
    typer.run(main)
