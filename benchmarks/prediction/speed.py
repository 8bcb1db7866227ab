"""Speed against accuracy of predictors, and what bad input costs the shipped vehicle model.

    python -m benchmarks.prediction speed

Futures of 5 s of all vehicles of a piece together, at validation places. Time is processor time of
one thread; a predictor's share of the default's at the same place does not depend on the machine.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from numpy import ndarray as Array
from torch import Tensor

from benchmarks.charts import OTHERS, OURS
from benchmarks.prediction.closed_loop import CLOSED_LOOP
from benchmarks.prediction.controllers import FUTURES, PLACES, PREDICTED
from benchmarks.prediction.places import DRAWN_RESOLUTION, make_drawn_scene
from benchmarks.prediction.reaction import HISTORY, format_rows
from benchmarks.prediction.results import Workspace
from benchmarks.results import describe_machine, write_json
from benchmarks.synthetic import draw_place, make_place, world_from_image
from benchmarks.synthetic.imagery import make_other_day
from geoaim.aim.aim import AIM
from geoaim.base.files import atomic_files, write_figure
from geoaim.base.labels import label_points
from geoaim.prediction.baselines import BASELINES, NOISY, Predictor
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.controllers import follow
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.dataset import cut_moving_and_parked
from geoaim.prediction.metrics import compute_metrics
from geoaim.prediction.plain import train_plain
from geoaim.prediction.predict import draw_covering
from geoaim.prediction.segments import Segments, concat
from geoaim.rendering.corners import make_ground_from_aim
from geoaim.rendering.ground import Ground
from geoaim.rendering.prefiltering import prefilter_ground

STRIDE = 120  # steps from a piece to the next: 5 pieces a minute
DEFAULT = "ITRA"
OTHER_METHODS = ("constant velocity", NOISY, "plain network")
LEARNT_AT = CLOSED_LOOP[:4]  # places of the plain network
NUMBERS = ("ms an agent", "minADE, m", "joint minADE, m", "collisions, %")
Row = dict[str, Any]
Numbers = Float[Array, "4"]  # `NUMBERS` at a place


@dataclass(frozen=True, eq=False)
class _Case:
    segments: Segments
    ground: Ground
    older: Ground  # of another day, season and sun, with changes on the ground


def run(workspace: Workspace) -> list[Path]:
    """Chart speed against accuracy, and measure what bad input costs; return the files."""
    cases = [_make_case(kind, seed) for seed, kind in PLACES]
    found: dict[str, list[Numbers]] = {}
    for name, predict in _make_predictors().items():
        workspace.progress(f"speed, {name}", 0, None)
        found[name] = [measure(predict, case) for case in cases]
    rows = [{"predictor": name, **_summarise(values)} for name, values in found.items()]
    model = read_pretrained("vehicle")
    stable = []
    for name, change in CHANGES.items():
        workspace.progress(f"stability, {name}", 0, None)
        values = [measure(model.sample, case, change(case)) for case in cases]
        stable.append({"input": name, **_summarise(values)})
    return _write(found, rows, stable, workspace.results)


def measure(predict: Predictor, case: _Case, shown: _Case | None = None) -> Numbers:
    """Measure a predictor at a place: `NUMBERS`. It may be shown something else than is true."""
    seen = shown or case
    generator = torch.Generator().manual_seed(0)
    given: dict[str, Any] = {"history": HISTORY, "samples": FUTURES, "generator": generator}
    began = time.process_time()
    futures = predict(seen.segments, seen.ground, **given)
    spent = time.process_time() - began
    known = case.segments.controlled & seen.segments.controlled
    metrics = compute_metrics(futures, replace(case.segments, controlled=known), HISTORY)
    agents = float(known.sum())
    return np.array(
        [
            1000 * spent / agents,
            metrics["minADE"].mean,
            metrics["joint minADE"].mean,
            100 * metrics["collision rate"].mean,
        ]
    )


def _make_case(kind: Any, seed: int) -> _Case:
    scene, _ = make_drawn_scene(kind, seed)
    steps = HISTORY + PREDICTED
    segments = cut_segments(scene, "vehicle", steps=steps, stride=STRIDE, joint=True)
    resolution, place = read_pretrained("vehicle").config.resolution, make_place(seed, kind=kind)
    image = draw_place(place, make_other_day(place), resolution=DRAWN_RESOLUTION)
    aim = AIM.from_image(image, world_from_image(place, DRAWN_RESOLUTION), place.world, "drawn")
    grounds = scene.ground, make_ground_from_aim(aim)
    return _Case(segments, *(prefilter_ground(ground, resolution) for ground in grounds))


def _make_predictors() -> dict[str, Predictor]:
    """Predictors by name; those of ITRA differ from the default by what their names say."""
    predictors = {name: BASELINES[name] for name in OTHER_METHODS[:2]}
    predictors[OTHER_METHODS[2]] = _learn_plain()
    predictors[DEFAULT] = read_pretrained("vehicle").sample
    for stride in (1, 10, 25):
        model = read_pretrained("vehicle")
        model.config = replace(model.config, view_stride=stride)
        predictors[f"look each {stride / 10:g} s"] = model.sample
    predictors["24 drawn, 6 chosen"] = partial(draw_covering, read_pretrained("vehicle"))
    model = read_pretrained("vehicle")
    model.controllers = [follow]
    predictors["without rules"] = model.sample
    blind = read_pretrained("vehicle")
    predictors["no map"] = partial(_sample_without_map, blind.sample)
    return predictors


def _learn_plain() -> Predictor:
    """Train the network without map and others at made places that are not measured."""
    config, parts = read_pretrained("vehicle").config, []
    for seed, kind in LEARNT_AT:
        scene, _ = make_drawn_scene(kind, seed)
        parts.append(cut_moving_and_parked(scene, config, HISTORY + PREDICTED))
    return train_plain(concat(parts), config, history=HISTORY).sample


def _sample_without_map(
    sample: Predictor, segments: Segments, ground: Ground, **given: Any
) -> Float[Tensor, "B K N T 4"]:
    grey = replace(ground, image=torch.full_like(ground.image, 0.5))
    return sample(segments, grey, **given)


def _move_map(case: _Case, *, shift: float = 0.0, scale: float = 1.0) -> _Case:
    """Show the map `shift` metres too far to the east, or too large about its middle."""
    matrix = case.ground.image_from_world.clone()
    middle = case.ground.bounds.mean(dim=1)  # (1, 2)
    matrix[:, :, :2] /= scale
    moved = middle - (middle + shift) / scale
    matrix[:, :, 2] += (case.ground.image_from_world[:, :, :2] * moved[:, None, :]).sum(dim=2)
    return replace(case, ground=replace(case.ground, image_from_world=matrix))


def _blur_map(case: _Case, *, metres: float) -> _Case:
    """Show the map averaged over squares of some metres."""
    pixels = case.ground.image_from_world[0, :, :2].norm(dim=1).mean()
    size = 2 * round(float(metres * pixels) / 2) + 1
    image = torch.nn.functional.avg_pool2d(case.ground.image[None], size, 1, size // 2)[0]
    return replace(case, ground=replace(case.ground, image=image))


def _disturb_tracks(case: _Case, *, metres: float) -> _Case:
    """Show observed positions with noise, which headings and speeds do not have."""
    states = case.segments.states.clone()
    noise = torch.randn(states[..., :HISTORY, :2].shape, generator=torch.Generator().manual_seed(0))
    states[..., :HISTORY, :2] += metres * noise
    return replace(case, segments=replace(case.segments, states=states))


def _mistake_speeds(case: _Case, *, factor: float) -> _Case:
    """Show speeds as if the scale of the recording were wrong."""
    states = case.segments.states.clone()
    states[..., :HISTORY, 3] *= factor
    return replace(case, segments=replace(case.segments, states=states))


def _show_late(case: _Case, *, steps: int) -> _Case:
    """Show all agents only from some steps before the last observed one on."""
    present = case.segments.present.clone()
    present[:, :, : HISTORY - steps] = False
    return replace(case, segments=replace(case.segments, present=present))


def _miss_agents(case: _Case, *, share: float) -> _Case:
    """Show neither vehicles nor others of a random share of agents; the others are predicted."""
    one = case.segments
    generator = torch.Generator().manual_seed(0)
    kept = torch.rand(one.controlled.shape, generator=generator) >= share
    present, controlled = one.present & kept[..., None], one.controlled & kept
    return replace(case, segments=replace(one, present=present, controlled=controlled))


CHANGES: Mapping[str, Callable[[_Case], _Case]] = {
    "as it is": lambda case: case,
    "positions with noise of 0.2 m": partial(_disturb_tracks, metres=0.2),
    "positions with noise of 0.5 m": partial(_disturb_tracks, metres=0.5),
    "speeds 10 % too high": partial(_mistake_speeds, factor=1.1),
    "seen for 0.5 instead of 1 s": partial(_show_late, steps=5),
    "a fifth of the agents not seen": partial(_miss_agents, share=0.2),
    "a map of another day": lambda case: replace(case, ground=case.older),
    "map blurred over 3 m": partial(_blur_map, metres=3.0),
    "map 1 m aside": partial(_move_map, shift=1.0),
    "map 3 m aside": partial(_move_map, shift=3.0),
    "map 5 % too large": partial(_move_map, scale=1.05),
    "a grey map": lambda case: replace(
        case, ground=replace(case.ground, image=torch.full_like(case.ground.image, 0.5))
    ),
}


def _summarise(values: Sequence[Numbers]) -> Row:
    """The mean of each number over places, and the lowest and highest of one place."""
    each = np.array(values)
    parts = zip(NUMBERS, each.mean(axis=0), each.min(axis=0), each.max(axis=0), strict=True)
    return {key: f"{mean:.3g} ({low:.3g} to {high:.3g})" for key, mean, low, high in parts}


def _write(
    found: Mapping[str, Sequence[Numbers]], rows: Sequence[Row], stable: Sequence[Row], folder: Path
) -> list[Path]:
    command = "python -m benchmarks.prediction speed"
    content = {"command": command, "machine": describe_machine(), "speed": rows}
    paths = [folder / f"speed{suffix}" for suffix in (".json", ".md", ".png")]
    tables = [f"`{command}`\n", format_rows(rows), "Stability\n", format_rows(stable)]
    with atomic_files(*paths) as parts:
        write_json({**content, "stability": stable}, parts[0])
        parts[1].write_text("\n".join(tables), encoding="utf-8")
        write_figure(draw(found), parts[2])
    return paths


def draw(found: Mapping[str, Sequence[Numbers]]) -> Figure:
    """Draw errors and collisions against time, with the range of places; the default is marked."""
    figure = Figure(figsize=(8, 9), layout="constrained")
    panels = figure.subplots(3, 1, sharex=True)
    for axes, column in zip(panels, (1, 2, 3), strict=True):
        for name, values in found.items():
            each = np.array(values)[:, [0, column]]
            (x, y), low, high = each.mean(axis=0), each[:, 1].min(), each[:, 1].max()
            ours = name not in OTHER_METHODS
            colour = OURS if ours else OTHERS
            axes.plot([x, x], [low, high], color=colour, alpha=0.35)
            size = 11 if name == DEFAULT else 6
            axes.plot(x, y, "*" if name == DEFAULT else "D" if ours else "o", color=colour, ms=size)
        axes.set(ylabel=NUMBERS[column], xscale="log", yscale="log" if column < 3 else "linear")
        axes.margins(0.12)
        if column < 3:
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
    panels[-1].set_xlabel(f"processor time, {NUMBERS[0]}, for {FUTURES} futures of 5 s")
    panels[-1].xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    figure.draw_without_rendering()  # so that the axes have their sizes
    for axes, column in zip(panels, (1, 2, 3), strict=True):
        points = np.array(
            [np.array(values)[:, [0, column]].mean(axis=0) for values in found.values()]
        )
        label_points(axes, points, list(found))
    return figure
