"""Moving layers of the viewer: tracks, traffic lights, futures and infractions."""

import math
import os
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import torch
from matplotlib.colors import to_hex

from geoaim.base.errors import TracksError
from geoaim.base.limits import MAX_POSITION_M, MAX_TIME_S, open_text, refuse_damaged
from geoaim.base.world import World
from geoaim.prediction.config import DEFAULT_CONFIGS
from geoaim.prediction.futures import Futures
from geoaim.rendering.ground import View
from geoaim.rendering.lines import LIGHT_COLOURS
from geoaim.rendering.pictures import render_agent_video
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene, find_agent, slice_scene, transform_stop_lines
from geoaim.simulation.road_rules import RoadRules
from geoaim.simulation.scene_infractions import detect_infractions
from geoaim.tracks.agent_types import get_colour
from geoaim.tracks.lights import Lights
from geoaim.tracks.tracks import Tracks
from geoaim.web.tiles import encode_picture

SPEED_COLOURS = [to_hex(colour) for colour in matplotlib.colormaps["plasma"](np.linspace(0, 1, 9))]
SPEED_STEP_KMH = 10  # the scale of speeds ends at a multiple of it
STEPS_AT_ONCE = 500  # steps that are searched for infractions at once
Description = dict[str, Any]


def describe_tracks(tracks: Tracks) -> tuple[Description, dict[str, Callable[[], bytes]]]:
    """Describe tracks, with their data: float64 times, float32 x, y, heading, speed."""
    places = tracks.states[..., :2][tracks.present]
    origin = places.mean(axis=0).round() if len(places) else np.zeros(2)
    agents, parts = [], []
    for row, present in enumerate(tracks.present):
        steps = np.flatnonzero(present)
        if not len(steps):
            continue
        first, stop = int(steps[0]), int(steps[-1]) + 1
        states = np.where(present[:, None], tracks.states[row], np.nan)[first:stop]
        parts.append((states - [*origin, 0.0, 0.0]).astype("<f4"))
        length, width = np.round(tracks.sizes[row], 2).tolist()
        agents.append(
            {
                "id": tracks.ids[row],
                "type": tracks.types[row],
                "length": length,
                "width": width,
                "first": first,
                "steps": stop - first,
            }
        )
    data: dict[str, Callable[[], bytes]] = {
        "tracks": np.concatenate(parts or [np.empty((0, 4), "<f4")]).tobytes,
        "times": tracks.times.astype("<f8").tobytes,
    }
    return {
        "path": "tracks",
        "times": "times",
        "origin": origin.tolist(),
        "agents": agents,
        "colours": {kind: to_hex(get_colour(kind)) for kind in dict.fromkeys(tracks.types)},
        "speeds": _describe_speeds(tracks),
    }, data


def _describe_speeds(tracks: Tracks) -> Description:
    """Describe the colours of speeds, from rest to the fastest agent."""
    fastest = float(tracks.states[..., 3][tracks.present].max(initial=0.0))
    most = max(1, math.ceil(3.6 * fastest / SPEED_STEP_KMH)) * SPEED_STEP_KMH
    return {"from": 0, "to": most, "unit": "km/h", "colours": SPEED_COLOURS}


def describe_lights(lights: Lights, world: World) -> Description:
    """Describe lights: ends of the stop lines in metres of a world, times and states."""
    return {
        "names": list(lights.names),
        "lines": np.round(transform_stop_lines(lights, world), 3).tolist(),
        "times": lights.times.tolist(),
        "states": lights.states.tolist(),
        "colours": [to_hex(colour) for colour in LIGHT_COLOURS],
    }


def describe_futures(futures: Futures) -> Description:
    """Describe futures: the points of each sample of each predicted agent."""
    positions = futures.states[..., :2].double().cpu().numpy().round(2)
    predicted = futures.mark_predicted()
    agents = [
        {
            "id": futures.scene.ids[agent],
            "samples": [path[np.isfinite(path).all(axis=1)].tolist() for path in paths],
        }
        for agent, paths in enumerate(positions.swapaxes(0, 1))
        if predicted[agent]
    ]
    end = futures.time + futures.states.shape[2] * futures.dt
    return {"start": round(futures.time, 3), "end": round(end, 3), "agents": agents}


def describe_futures_file(path: str | os.PathLike[str]) -> Description:
    """Describe the predicted agents in a file that `geoaim predict -o futures.csv` wrote."""
    with refuse_damaged(path, TracksError, "a .csv that `geoaim predict` wrote"):
        with open_text(path, TracksError) as file:
            table = pd.read_csv(file, comment="#", dtype={"id": str})
        numbers = np.abs(table[["time", "x", "y"]].to_numpy(float))
        if table.empty or not (numbers <= (MAX_TIME_S, MAX_POSITION_M, MAX_POSITION_M)).all():
            raise ValueError("it has no rows, or a time, x or y that is not finite or too large")
        agents = [
            {
                "id": str(name),
                "samples": [
                    sample[["x", "y"]].to_numpy(float).round(2).tolist()
                    for _, sample in rows.groupby("sample")
                ],
            }
            for name, rows in table.groupby("id", sort=False)
            if _is_predicted(rows)
        ]
        times = np.unique(table["time"].to_numpy(float))
        dt = float(np.diff(times).min()) if len(times) > 1 else 0.0
        start, end = round(float(times[0]) - dt, 3), float(times[-1])
        return {"start": start, "end": end, "agents": agents}


def _is_predicted(rows: pd.DataFrame) -> bool:
    """Whether the samples of an agent differ; of one sample nothing can be said."""
    if rows["sample"].nunique() == 1:
        return True
    places = rows.groupby("time")[["x", "y"]]
    return bool((places.max() > places.min()).to_numpy().any())


def list_infractions(scene: Scene, rules: RoadRules) -> list[dict[str, Any]]:
    """List when the infractions in a scene begin: time (s), agent and kind.

    Of estimated agents no collision is listed: their boxes overlap by errors of their sizes.
    """
    kinds = ["off road", "red light"] if scene.smoothed else ["collision", "off road", "red light"]
    everyone = torch.ones(len(scene.ids), dtype=torch.bool)
    marks = []
    last = {kind: torch.zeros_like(everyone)[:, None] for kind in kinds}
    for start in range(0, len(scene.times) - 1, STEPS_AT_ONCE):
        part = slice_scene(scene, slice(start, start + STEPS_AT_ONCE + 1))
        if len(part.times) < 2:
            continue
        found = detect_infractions(part, everyone, rules)
        for kind in kinds:
            if kind not in found:
                continue
            now = found[kind][0]
            begins = now & ~torch.cat([last[kind], now[:, :-1]], dim=1)
            last[kind] = now[:, -1:]
            for agent, step in begins.nonzero().tolist():
                time = round(float(part.times[step + 1]), 6)
                marks.append({"time": time, "agent": scene.ids[agent], "kind": kind})
    return sorted(marks, key=lambda mark: float(mark["time"]))


def render_model_view(scene: Scene, agent_id: str, step: int) -> bytes:
    """Render an agent's surroundings in the extent and at the resolution that models see."""
    agent = find_agent(scene, agent_id)
    if step >= len(scene.times) or not bool(scene.present[agent, step]):
        raise KeyError(f"agent {agent_id} is absent then")
    kind = "pedestrian" if scene.types[agent] == "pedestrian" else "vehicle"
    config = DEFAULT_CONFIGS[kind]
    view = View(config.view_size, config.view_size, config.resolution)
    averaged = _average_ground(scene, config.resolution)
    return encode_picture(next(render_agent_video(averaged, agent, view, torch.tensor([step]))))


@lru_cache(maxsize=2)  # one entry for each of the two kinds of models
def _average_ground(scene: Scene, resolution: float) -> Scene:
    return replace(scene, ground=prefilter_ground(scene.ground, resolution))
