"""Infractions of recordings and of policies: on synthetic places, in Karlsruhe and of SinD.

    GEOAIM_DATA=... python -m benchmarks.simulation.policies --json docs/bench/policies.json

Synthetic places of each kind are simulated for 60 s with the seeds 20 to 29; settings were chosen
on the seeds 0 to 19. The other policies, which follow no road, are simulated for 6 s at a time.
First comes how far the recorded vehicles are off the drivable area, without a tolerance.
"""

import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch
import typer
from jaxtyping import Bool
from torch import Tensor

from benchmarks.data import find_data, require_data
from benchmarks.results import JsonFile, print_rows, write_rows
from benchmarks.simulation.drivable import JUNCTIONS
from benchmarks.synthetic import make_sample, tracks_of
from benchmarks.synthetic.roads.lanelet import make_lanelet_map
from benchmarks.synthetic.roads.layouts import PlaceKind
from benchmarks.synthetic.sample import Sample
from benchmarks.synthetic.traffic.signals import compute_light_states
from geoaim.base.errors import TracksError
from geoaim.hdmap.lanelet2 import HDMap, read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.rendering.scene import Scene, make_scene, slice_scene
from geoaim.simulation.episodes import HISTORY_STEPS, simulate_scene
from geoaim.simulation.infractions import OFFROAD_TOLERANCE_M, compute_offroad_distance
from geoaim.simulation.road_rules import RoadRules, make_road_rules
from geoaim.simulation.scene_infractions import detect_infractions
from geoaim.tracks.agent_types import select_group
from geoaim.tracks.changes import resample_tracks
from geoaim.tracks.formats import read_tracks
from geoaim.tracks.lights import Lights
from geoaim.tracks.tracks import Tracks

TUNED_SEEDS, SEEDS = range(10), range(20, 30)
TOLERANCES_M = (0.0, 0.2, OFFROAD_TOLERANCE_M)
MAP_RESOLUTION = 0.5  # metres per pixel of drawn HD maps, which only bound the scene
RATE = 10.0  # Hz
IDM_S, OTHER_S = 60.0, 6.0  # simulated at a time
OTHER_EVERY_S = 12.0
OTHERS = ("constant-velocity", "constant-turn-rate")
INFRACTIONS = (
    *("collision", "collision with replay", "contact"),
    *("off road", "red light", "wrong way"),
)
SIND = {
    "Chongqing": ("NR_ll2.osm", "6_22_NR_1/Ped_smoothed_tracks.csv"),
    "Changchun": ("Changchun_Pudong.osm", "changchun_pudong_507_009/Ped_smoothed_tracks.csv"),
}
Case = tuple[Scene, RoadRules]
Counts = dict[str, tuple[float, float]]  # infractions, and steps where they are counted


def _make_place(kind: PlaceKind, seed: int) -> Case:
    """Simulate a minute of synthetic traffic, with its lights, on its HD map."""
    sample = make_sample(seed, kind=kind, video=None)
    place, tracks = sample.place, tracks_of(sample)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.osm"
        frame = place.roads, place.world_from_plan, place.world
        path.write_bytes(make_lanelet_map(*frame, complete=True))
        hdmap = read_hdmap(path, place.world)
    return _make_case(hdmap, tracks, _find_lights(sample, hdmap, tracks))


def _find_lights(sample: Sample, hdmap: HDMap, tracks: Tracks) -> Lights | None:
    signals = sample.recordings[0].signals
    names = tuple(line.signal for line in hdmap.stop_lines)
    if not names:
        return None
    states = compute_light_states(signals, tracks.times)[:, [*map(signals.names.index, names)]]
    lines = np.array([line.ends for line in hdmap.stop_lines])
    return Lights(names, lines, tracks.times, states, hdmap.world)


def _make_case(hdmap: HDMap, tracks: Tracks, lights: Lights | None = None) -> Case:
    aim = draw_hdmap(hdmap, resolution=MAP_RESOLUTION)
    return make_scene(aim, tracks, lights), make_road_rules(hdmap)


def _read_karlsruhe(junction: str) -> Iterator[Case]:
    """Read the recordings of a junction that last nearly as long as drivers are simulated."""
    folder = require_data("tracks/karlsruhe")
    for file in sorted((folder / "tracks" / junction).glob("vehicle_tracks*.csv")):
        tracks = resample_tracks(read_tracks(file), RATE)
        if tracks.times[-1] - tracks.times[0] > 0.9 * IDM_S:
            yield _make_case(read_hdmap(folder / "maps" / f"{junction}.osm", tracks.world), tracks)


def _read_sind(city: str) -> Iterator[Case]:
    """Read the pedestrians of a junction of SinD; its vehicles are not in the public sample."""
    hdmap_name, tracks_name = SIND[city]
    folder = require_data("tracks/sind") / city
    tracks = resample_tracks(read_tracks(folder / tracks_name), RATE)
    yield _make_case(read_hdmap(folder / hdmap_name), tracks)


def _count(scene: Scene, agents: Bool[Tensor, "A"], rules: RoadRules) -> Counts:
    """Count the infractions of agents, and the metres that they cover."""
    found = detect_infractions(scene, agents, rules, first=HISTORY_STEPS)
    counts = {
        name: (float((wrong & chances).sum()), float(chances.sum()))
        for name, (wrong, chances) in found.items()
    }
    speeds = scene.speeds[agents].nan_to_num()[:, HISTORY_STEPS:]
    return counts | {"metres": (float(speeds.sum()) * scene.dt, 1.0)}


def _simulate(case: Case, policy: str) -> Iterator[tuple[Counts, Counts]]:
    """Simulate pieces of a recording: the counts of the simulation and of the recording."""
    scene, rules = case
    begin, end = float(scene.times[0]), float(scene.times[-1])
    length = min(IDM_S, end - begin)
    duration, every = (length, length) if policy == "idm" else (OTHER_S, OTHER_EVERY_S)
    for start in begin + every * np.arange(max(1, int(length / every))):
        try:
            episode = simulate_scene(scene, policy, start=float(start), duration=duration)
        except TracksError:  # no agent is present
            continue
        first = int((scene.times - start).abs().argmin())
        recorded = slice_scene(scene, slice(first, first + len(episode.scene.times)))
        parts = (_count(part, episode.controlled, rules) for part in (episode.scene, recorded))
        yield next(parts), next(parts)


def _sum(parts: Iterable[Counts]) -> Counts:
    total: Counts = {}
    for counts in parts:
        for name, (wrong, chances) in counts.items():
            before = total.get(name, (0.0, 0.0))
            total[name] = before[0] + wrong, before[1] + chances
    return total


def _format_rates(name: str, simulated: Counts, recorded: Counts) -> str | None:
    """Format the rates of an infraction, percent: simulated / recorded; "0" is exactly none."""
    if name not in recorded and name not in simulated:
        return None
    rates = []
    for counts in (simulated, recorded):
        wrong, chances = counts.get(name, (0.0, 0.0))
        share = f"{100 * wrong / chances:.3f}" if wrong else "0"
        rates.append(share if chances else "-")
    return " / ".join(rates)


def _measure(
    place: str, cases: Iterable[Case], policies: Iterable[str]
) -> Iterator[Mapping[str, Any]]:
    """Measure the rates of policies on the recordings of a place."""
    kept = list(cases)
    for policy in policies:
        pairs = [pair for case in kept for pair in _simulate(case, policy)]
        simulated, recorded = (_sum(parts) for parts in zip(*pairs, strict=True))
        rates = {f"{name}, %": _format_rates(name, simulated, recorded) for name in INFRACTIONS}
        yield {
            "place": place,
            "policy": policy,
            "agent steps": int(simulated["collision"][1]),
            **rates,
            "way covered, %": 100 * simulated["metres"][0] / recorded["metres"][0],
        }


def _measure_corners(place: str, cases: Iterable[Case]) -> Mapping[str, Any]:
    """Measure how far the furthest corners of recorded vehicles are off the drivable area."""
    distances = []
    for scene, rules in cases:
        vehicles = torch.from_numpy(select_group(scene.types, "vehicle"))
        present = scene.present & vehicles[:, None]
        if rules.drivable is not None:
            sizes = scene.sizes[:, None].expand(*present.shape, 2)
            given = rules.drivable, scene.poses, sizes, present
            distances.append(compute_offroad_distance(*given)[present])
    every = torch.cat(distances)
    shares = {
        f"corner over {limit:g} m off, %": 100 * float((every > limit).float().mean())
        for limit in TOLERANCES_M
    }
    return {
        "recording": place,
        "vehicle steps": len(every),
        **shares,
        "at most, m": float(every.max()),
    }


def _measure_recordings() -> Iterator[Mapping[str, Any]]:
    for seeds in (TUNED_SEEDS, SEEDS):
        for kind in get_args(PlaceKind):
            cases = (_make_place(kind, seed) for seed in seeds)
            yield _measure_corners(f"{kind}, seeds {seeds[0]} to {seeds[-1]}", cases)
    if find_data() is not None:
        for junction in JUNCTIONS:
            yield _measure_corners(junction, _read_karlsruhe(junction))


def _measure_all() -> Iterator[Mapping[str, Any]]:
    yield from _measure_recordings()
    every = ("idm", *OTHERS)
    for kind in get_args(PlaceKind):
        yield from _measure(kind, (_make_place(kind, seed) for seed in SEEDS), every)
    if find_data() is not None:
        for junction in JUNCTIONS:
            yield from _measure(junction, _read_karlsruhe(junction), every)
        for city in SIND:
            yield from _measure(f"SinD, {city}", _read_sind(city), OTHERS)  # no vehicles


def main(json: JsonFile = None) -> None:
    """Count the infractions of recordings and of policies."""
    torch.set_num_threads(1)
    rows = print_rows(_measure_all())
    write_rows(rows, json, command="python -m benchmarks.simulation.policies")


if __name__ == "__main__":
    typer.run(main)
