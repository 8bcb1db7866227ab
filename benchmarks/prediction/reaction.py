"""Whether drivers react: to a leader on their own path, and to each other over twenty seconds.

    python -m benchmarks.prediction reaction

A follower is a recorded vehicle. Its leader is put on the follower's own path, or somebody crosses
that path, or a light on it turns red; nobody else is there.
The sample is seed 1. Places of `VAL` are for choices (`reaction_validation`), those of `TEST` for
the one test; no model is trained on either.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from torch import Tensor

from benchmarks.prediction.places import Places, make_drawn_scene
from benchmarks.prediction.results import Workspace
from benchmarks.results import describe_machine, write_json
from geoaim.base.files import atomic_files
from geoaim.prediction.baselines import BASELINES, NOISY, Predictor
from geoaim.prediction.checkpoints import read_model, read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS
from geoaim.prediction.controllers import follow
from geoaim.prediction.cutting import cut_scene, cut_segments
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import compute_ade
from geoaim.prediction.policies import ITRAPolicy
from geoaim.prediction.segments import PEDESTRIAN, VEHICLE, Segments, make_segment_scenario, pick
from geoaim.rendering.ground import Ground
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene, slice_scene
from geoaim.simulation.episodes import simulate_scene
from geoaim.simulation.idm import make_idm_policy
from geoaim.simulation.infractions import detect_red_light_running
from geoaim.simulation.overlap import compute_box_distance
from geoaim.simulation.road_rules import RoadRules
from geoaim.simulation.routes import extract_routes
from geoaim.simulation.scene_infractions import detect_infractions
from geoaim.simulation.simulator import apply_rollout, rollout
from geoaim.tracks.lights import GREEN, RED

SAMPLE: Places = ((1, "junction"),)
VAL: Places = (
    *((811, "junction"), (812, "t"), (813, "street"), (814, "roundabout"), (871, "junction")),
    *((872, "t"), (873, "street"), (874, "roundabout"), (875, "junction"), (876, "street")),
)
TEST: Places = ((891, "junction"), (892, "t"), (893, "street"), (894, "roundabout"))
HISTORY, PREDICTED, FUTURES = MAX_HISTORY_STEPS, 60, 6  # steps of 0.1 s; futures of each case
MAX_CASES = 24  # followers of each place
MIN_SPEED_MPS, MIN_WAY = 5.0, 0.7  # of followers; their recorded way, as a share of speed x time
LEADER_SIZE_M = (4.5, 1.9)
HORIZONS_S = (3, 5, 8)
CLOSED_STEPS = 200  # for which all vehicles are driven
HARD_MPS2 = 4.0  # harder braking is counted
Driver = Callable[[Segments], Float[Tensor, "B K N T 4"]]
Row = dict[str, Any]


@dataclass(frozen=True)
class Situation:
    """Where a leader is at the start, and what it does."""

    headway: float | None  # s, from bumper to bumper; None: a stop needs `STOP_MPS2`
    speed: float = 1.0  # as a share of the follower's
    braking: float = 0.0  # m/s²
    aside: float = 0.0  # m to the left, from where it moves onto the path within `CUT_IN_S`


@dataclass(frozen=True)
class Crossing:
    """Somebody who crosses from the right, at even speed, where a stop needs `STOP_MPS2`.

    They are in the middle of the follower's path when its front would get there.
    """

    speed: float  # m/s
    size: tuple[float, float]  # length and width, metres
    layer: int  # as in segments


STOP_MPS2, CUT_IN_S = 3.0, 1.5
ALONE = "networks alone"
FREE, LIGHT = "no leader", "light turns red"  # as the future begins; a stop needs `STOP_MPS2`
LIGHT_WIDTH_M = 3.5
SITUATIONS: Mapping[str, Situation | Crossing | None] = {
    "brakes, headway 1.5 s": Situation(1.5, braking=4.0),
    "brakes, headway 2.5 s": Situation(2.5, braking=4.0),
    "stands": Situation(None, speed=0.0),
    "cuts in": Situation(1.0, speed=0.7, aside=3.2),
    "vehicle crosses": Crossing(8.0, LEADER_SIZE_M, VEHICLE),
    "pedestrian crosses": Crossing(1.4, (0.5, 0.6), PEDESTRIAN),
    LIGHT: None,
}


def run(workspace: Workspace) -> list[Path]:
    """Measure whether the pretrained vehicle model reacts to others, with and without its rules.

    Returns:
        The files.
    """
    alone = read_pretrained("vehicle")
    alone.controllers = [follow]
    models = {ALONE: alone, "with rules": read_pretrained("vehicle")}
    places = {"sample": SAMPLE, **_set_roundabouts_apart("test", TEST)}
    parts = measure_places(models, places, workspace)
    return write_rows("reaction", parts, workspace)


def compare(workspace: Workspace) -> list[Path]:
    """Compare the models `models/closed_loop/*.pt` with the pretrained one at validation places."""
    models = {"pretrained": read_pretrained("vehicle")}
    paths = sorted((workspace.models / "closed_loop").glob("*.pt"))
    models |= {path.stem: read_model(path) for path in paths}
    parts = measure_places(models, _set_roundabouts_apart("validation", VAL), workspace)
    return write_rows("reaction_validation", parts, workspace)


def _set_roundabouts_apart(name: str, places: Places) -> dict[str, Places]:
    """Where the road bends, leaders are seen worse: figures of all places together hide it."""
    bent = tuple(place for place in places if place[1] == "roundabout")
    others = tuple(place for place in places if place[1] != "roundabout")
    return {f"{name}, roundabouts": bent, f"{name}, other places": others}


def write_rows(name: str, parts: Mapping[str, Sequence[Row]], workspace: Workspace) -> list[Path]:
    """Write the tables of an experiment, as JSON and as Markdown."""
    command = f"python -m benchmarks.prediction {name}"
    paths = [workspace.results / f"{name}{suffix}" for suffix in (".json", ".md")]
    with atomic_files(*paths) as written:
        write_json({"command": command, "machine": describe_machine(), **parts}, written[0])
        tables = [f"{title}\n\n{format_rows(rows)}" for title, rows in parts.items()]
        written[1].write_text("\n".join([f"`{command}`\n", *tables]), encoding="utf-8")
    return paths


def measure_places(
    models: Mapping[str, ITRA], places: Mapping[str, Places], workspace: Workspace
) -> dict[str, list[Row]]:
    """Measure models among leaders and in closed loop; IDM and the recording stand beside them."""
    resolution = next(iter(models.values())).config.resolution
    leaders, closed = [], []
    for name, some in places.items():
        cases, loops = [], []
        for seed, kind in some:
            workspace.progress(f"reaction, {kind} {seed}", 0, None)
            scene, rules = make_drawn_scene(kind, seed)
            ground = prefilter_ground(scene.ground, resolution)
            cases.append((find_followers(scene), ground))
            loops += measure_closed_loop(models, scene, ground, rules)
        leaders += measure_leaders(name, models, cases)
        closed += _sum_rows(name, loops)
    return {"leaders": leaders, "closed loop": closed}


def find_followers(scene: Scene) -> Segments:
    """Find recorded vehicles that drive on, each alone in a segment."""
    steps = HISTORY + PREDICTED
    segments = cut_segments(scene, "vehicle", steps=steps, stride=steps // 3)
    alone = segments.controlled.float().argmax(dim=1)
    rows = torch.arange(len(segments))
    states = segments.states[rows, alone]
    way = states[:, HISTORY - 1 :, :2].diff(dim=1).norm(dim=2).sum(dim=1)
    speed = states[:, HISTORY - 1, 3]
    drives = (speed > MIN_SPEED_MPS) & (way > MIN_WAY * speed * PREDICTED * segments.dt)
    chosen = drives.nonzero()[:, 0]
    chosen = chosen[torch.randperm(len(chosen), generator=torch.Generator().manual_seed(0))]
    chosen = chosen[:MAX_CASES]
    columns = alone[chosen, None]
    some = pick(segments, chosen)
    names = ("states", "present", "sizes", "layers", "controlled")
    taken: dict[str, Any] = {name: _take(getattr(some, name), columns) for name in names}
    return replace(some, **taken, ids=())


def put_in(followers: Segments, situation: Situation | Crossing | None) -> Segments:
    """Put a leader or somebody who crosses before each follower, or with None a light."""
    states, dt = followers.states[:, 0].numpy(), followers.dt
    placed = []
    for path, (length, _) in zip(states, followers.sizes[:, 0].tolist(), strict=True):
        speed = float(path[HISTORY - 1, 3])
        gap = speed**2 / (2 * STOP_MPS2)
        if isinstance(situation, Situation):
            if situation.headway is not None:
                gap = situation.headway * speed
            gap += (length + LEADER_SIZE_M[0]) / 2
            placed.append(_drive_along(path, gap, speed * situation.speed, situation, dt))
        elif situation is not None:
            place = _locate(path, gap + (length + situation.size[1]) / 2)
            placed.append(_cross(place, situation, gap / speed, dt, len(path)))
        else:
            x, y, heading = _locate(path, gap + length / 2)
            half = LIGHT_WIDTH_M / 2 * np.array([-np.sin(heading), np.cos(heading)])
            placed.append(np.add([x, y], [half, -half]))
    added = torch.tensor(np.array(placed)).to(followers.states)[:, None]
    count = len(followers)
    if situation is None:
        red = torch.full((count, followers.steps, 1), RED)
        red[:, :HISTORY] = GREEN
        return replace(followers, stop_lines=added, light_states=red)
    size, layer = LEADER_SIZE_M, VEHICLE
    if isinstance(situation, Crossing):
        size, layer = situation.size, situation.layer
    return replace(
        followers,
        states=torch.cat([followers.states, added], dim=1),
        present=torch.ones(count, 2, followers.steps, dtype=torch.bool),
        sizes=torch.cat([followers.sizes, torch.tensor(size).expand(count, 1, 2)], dim=1),
        layers=torch.cat([followers.layers, torch.full((count, 1), layer)], dim=1),
        controlled=torch.tensor([[True, False]]).expand(count, 2),
    )


def _measure_way(states: Float[Array, "T 4"]) -> Float[Array, "T"]:
    return np.concatenate([[0.0], np.hypot(*np.diff(states[:, :2], axis=0).T).cumsum()])


def _locate(states: Float[Array, "T 4"], gap: float) -> Float[Array, "3"]:
    """x, y and heading on a path, at a way from the last observed step; straight on at its end."""
    arc = _measure_way(states)
    way = arc[HISTORY - 1] + gap
    beyond = max(way - arc[-1], 0.0)
    heading = np.interp(way, arc, np.unwrap(states[:, 2]))
    x, y = (np.interp(way, arc, column) for column in states[:, :2].T)
    return np.array([x + beyond * np.cos(heading), y + beyond * np.sin(heading), heading])


def _cross(
    place: Float[Array, "3"], crossing: Crossing, meets: float, dt: float, steps: int
) -> Float[Array, "T 4"]:
    """Drive straight to the left over a place, where one is `meets` s after the last observed."""
    x, y, heading = place
    way = crossing.speed * ((np.arange(steps) - (HISTORY - 1)) * dt - meets)
    turned = np.full(steps, heading + np.pi / 2)
    speeds = np.full(steps, crossing.speed)
    return np.stack([x + way * np.cos(turned), y + way * np.sin(turned), turned, speeds], axis=1)


def _drive_along(
    states: Float[Array, "T 4"], gap: float, speed: float, situation: Situation, dt: float
) -> Float[Array, "T 4"]:
    """Drive along a path, from a gap at the last observed step on; before that at even speed."""
    arc = _measure_way(states)
    time = (np.arange(len(states)) - (HISTORY - 1)) * dt
    after = np.maximum(time, 0.0)
    if situation.braking:
        after = np.minimum(after, speed / situation.braking)
    way = arc[HISTORY - 1] + gap + speed * (np.minimum(time, 0.0) + after)
    way -= situation.braking * after**2 / 2
    beyond = np.maximum(way - arc[-1], 0.0)
    x, y, heading = (
        np.interp(way, arc, column) for column in (*states[:, :2].T, np.unwrap(states[:, 2]))
    )
    aside = situation.aside * np.clip(1 - time / CUT_IN_S, 0.0, 1.0)
    x = x + beyond * np.cos(heading) - aside * np.sin(heading)
    y = y + beyond * np.sin(heading) + aside * np.cos(heading)
    speeds = np.where(time <= 0, speed, speed - situation.braking * after)
    return np.stack([x, y, heading, speeds], axis=1)


def measure_leaders(
    name: str, models: Mapping[str, ITRA], cases: Sequence[tuple[Segments, Ground]]
) -> list[Row]:
    """Measure followers behind each kind of leader, and without any, at all places of a group."""
    rows = []
    for driver in (*models, "IDM"):
        model = models.get(driver)
        free = [drive_followers(model, *case) for case in cases]
        for title in (FREE, *SITUATIONS):
            parts = []
            for (followers, ground), alone in zip(cases, free, strict=True):
                if title == FREE:
                    parts.append(compare_led(FREE, alone, alone, followers))
                    continue
                led = put_in(followers, SITUATIONS[title])
                parts.append(compare_led(title, drive_followers(model, led, ground), alone, led))
            values = {key: torch.cat([part[key].flatten() for part in parts]) for key in parts[0]}
            means = {key: round(float(value.float().nanmean()), 3) for key, value in values.items()}
            recorded = float(torch.cat([f.states[:, 0, -1, 3] for f, _ in cases]).mean())
            kept = {"places": name, "driver": driver, "leader": title, **means}
            rows.append({**kept, "recorded m/s after 6 s": round(recorded, 2)})
    return rows


def drive_followers(
    model: ITRA | None, segments: Segments, ground: Ground
) -> Float[Tensor, "B K N T 4"]:
    """Drive the followers by a model or, on their recorded paths, as intelligent drivers."""
    if model is not None:
        generator = torch.Generator().manual_seed(0)
        return model.sample(segments, ground, history=HISTORY, samples=FUTURES, generator=generator)
    parts = [pick(segments, torch.tensor([row])) for row in range(len(segments))]
    return torch.cat([_drive_idm(part) for part in parts])


def _drive_idm(segment: Segments) -> Float[Tensor, "1 1 N T 4"]:
    scenario = make_segment_scenario(segment)
    driven = segment.states[..., 3].amax(dim=2), segment.sizes, segment.controlled
    lights = segment.stop_lines[0], segment.light_states
    policy = make_idm_policy(extract_routes(scenario), *driven, *lights)
    return rollout(scenario, policy, segment.controlled, history=HISTORY)[:, None]


def _detect_running(states: Float[Tensor, "B K T 4"], segments: Segments) -> Bool[Tensor, "B K"]:
    """Whether the followers ever run the red light."""
    futures = states.shape[1]
    poses = states[:, :, HISTORY - 1 :, :3].flatten(0, 1)[:, None]  # (B K, 1, t, 3)
    rows = torch.arange(len(segments)).repeat_interleave(futures)
    lights = segments.stop_lines[rows], segments.light_states[rows, -1]
    size, there = segments.sizes[rows, :1, 0], torch.ones(len(rows), 1, dtype=torch.bool)
    runs = [
        detect_red_light_running(poses[:, :, k], poses[:, :, k + 1], size, there, *lights)
        for k in range(poses.shape[2] - 1)
    ]
    return torch.stack(runs).any(dim=0).view(-1, futures)


def compare_led(
    led: str,
    states: Float[Tensor, "B K n T 4"],
    free: Float[Tensor, "B K m T 4"],
    segments: Segments,
) -> dict[str, Tensor]:
    """Compare futures with those without a leader."""
    future, alone = states[:, :, 0, HISTORY - 1 :], free[:, :, 0, HISTORY - 1 :]
    way, free_way = (x[..., :2].diff(dim=2).norm(dim=3).cumsum(dim=2) for x in (future, alone))
    braking = -future[..., 3].diff(dim=2) / segments.dt
    found = {
        "m less in 3 s": (free_way - way)[..., round(3 / segments.dt) - 1],
        "m/s after 6 s": future[..., -1, 3],
        f"braking over {HARD_MPS2:g} m/s²": (braking > HARD_MPS2).any(dim=2),
    }
    if led == LIGHT:
        return {"hits": _detect_running(states[:, :, 0], segments)} | found
    if led == FREE:
        return found
    poses, sizes = states[..., HISTORY:, :3], segments.sizes[:, None, :, None]
    gap = compute_box_distance(poses[:, :, 0], sizes[:, :, 0], poses[:, :, 1], sizes[:, :, 1])
    closing = -gap.diff(dim=2) / segments.dt
    time = torch.where(closing > 0, gap[..., 1:] / closing.clamp_min(0.01), torch.inf)
    hits = (gap < 0).any(dim=2)
    least = time.amin(dim=2).clamp(0, 10)
    return {
        "hits": hits,
        "least gap, m": gap.amin(dim=2),
        "least time to collision, s": least,
    } | found


def measure_closed_loop(
    models: Mapping[str, ITRA], scene: Scene, ground: Ground, rules: RoadRules
) -> list[dict[str, Any]]:
    """Drive all vehicles of a scene by models, by IDM and as recorded, `CLOSED_STEPS` each time.

    Returns:
        For each piece of the scene and each driver, the sums and counts of each quantity.
    """
    found = []
    length = HISTORY + CLOSED_STEPS
    for start in range(0, len(scene.times) - length + 1, CLOSED_STEPS):
        piece = slice_scene(scene, slice(start, start + length))
        segment = cut_scene(piece, "vehicle")
        index = torch.tensor([scene.ids.index(name) for name in segment.ids[0]])
        controlled = torch.zeros(len(scene.ids), dtype=torch.bool)
        controlled[index] = segment.controlled[0]
        known = torch.isfinite(piece.observed).all(dim=2)
        piece = replace(piece, present=piece.present & known)
        driven = {}
        for name, model in models.items():
            poses = torch.full((len(scene.ids), length, 4), torch.nan)
            poses[index] = drive_all(model, segment, ground, start)
            driven[name] = apply_rollout(piece, poses, 0), controlled
        idm = simulate_scene(
            scene,
            "idm",
            start=float(piece.times[0]),
            duration=float(piece.times[-1] - piece.times[0]),
        )
        driven |= {"IDM": (idm.scene, idm.controlled), "recording": (piece, controlled)}
        for name, (one, some) in driven.items():
            found.append({"driver": name, **count_infractions(one, some, rules)})
    predictors = {name: model.sample for name, model in models.items()}
    for driver, predict in {**predictors, NOISY: BASELINES[NOISY]}.items():
        errors = {
            f"minADE in {seconds} s": _measure_errors(predict, scene, ground, seconds)
            for seconds in HORIZONS_S
        }
        found.append({"driver": driver, **errors})
    return found


def drive_all(model: ITRA, segment: Segments, ground: Ground, seed: int) -> Float[Tensor, "N T 4"]:
    """Drive all vehicles of a segment in closed loop, by latents of the prior."""
    generator = torch.Generator().manual_seed(seed)
    policy = ITRAPolicy(model, segment, ground, history=HISTORY, generator=generator)
    with torch.no_grad():
        return rollout(policy.scenario, policy, segment.controlled, history=HISTORY)[0]


def _measure_errors(
    predict: Predictor, scene: Scene, ground: Ground, seconds: int
) -> tuple[float, float]:
    """minADE of vehicles' futures, which is summed; and the number of vehicles."""
    steps = HISTORY + round(seconds / scene.dt)
    segments = cut_segments(scene, "vehicle", steps=steps, stride=steps, joint=True)
    generator = torch.Generator().manual_seed(0)
    futures = predict(segments, ground, history=HISTORY, samples=FUTURES, generator=generator)
    errors = compute_ade(futures, segments, HISTORY).amin(dim=1)[segments.controlled]
    errors = errors[errors.isfinite()]
    return float(errors.sum()), len(errors)


def count_infractions(scene: Scene, agents: Bool[Tensor, "A"], rules: RoadRules) -> dict[str, Any]:
    """Count agents that ever collide, infractions, the steps that are judged, and metres."""
    found = detect_infractions(scene, agents, rules, first=HISTORY)
    wrong, _ = found["collision"]
    there = scene.present[:, HISTORY:].any(dim=1) & agents
    vehicles = float(there.sum())
    counts = {"ever collide, %": (100 * float(wrong.any(dim=1).sum()), vehicles)}
    for name in ("off road", "red light"):
        if name in found:
            marked, judged = found[name]
            share = 100 * float((marked & judged).sum()), float(judged.sum())
            counts[f"{name}, % of steps"] = share
    metres = scene.speeds[agents].nan_to_num()[:, HISTORY:].abs().sum() * scene.dt
    return {**counts, "metres of each": (float(metres), vehicles)}


def _sum_rows(name: str, found: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Sum the counts of all pieces, driver by driver."""
    rows = []
    for driver in dict.fromkeys(one["driver"] for one in found):
        row: Row = {"places": name, "driver": driver}
        some = [one for one in found if one["driver"] == driver]
        for key in [
            key for key in dict.fromkeys(k for one in some for k in one) if key != "driver"
        ]:
            sums, counts = np.sum([one[key] for one in some if key in one], axis=0)
            row[key] = round(float(sums) / float(counts), 3)
        driven = sum(one["metres of each"][1] for one in some if "metres of each" in one)
        row |= {"vehicles": int(driven)} if driven else {}
        rows.append(row)
    return rows


def _take(values: Tensor, columns: Tensor) -> Tensor:
    """Take one agent of each segment."""
    return values[torch.arange(len(values))[:, None], columns]


def format_rows(rows: Sequence[Row]) -> str:
    """Format rows as a table in Markdown."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = [f"| {' | '.join(names)} |", f"|{' --- |' * len(names)}"]
    lines += [f"| {' | '.join(str(row.get(name, '')) for name in names)} |" for row in rows]
    return "\n".join(lines) + "\n"
