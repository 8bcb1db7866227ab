"""Datasets: training and validation segments of recordings, and the maps of their places."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from geoaim.base.errors import TracksError, name_option, warn
from geoaim.base.progress import Progress, notebook_progress
from geoaim.prediction.config import SEGMENT_STEPS, SEGMENT_STRIDES, Config
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.segments import Segments, concat, pick
from geoaim.prediction.sureness import mark_sure
from geoaim.rendering.atlas import stack_grounds
from geoaim.rendering.ground import Ground, View
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene, slice_scene

PARTS = ("training", "validation")
MAP_DENSITY = 2  # map pixels per side of a view pixel: fewer than by default, to save memory
PARKED_SHARE = 0.6  # most segments of parked agents for each one of a moving agent
HELD_OUT = 7  # one of so many agents is held out, to choose by
VAL_FRACTION = 0.05  # share of each recording, at its end, as in the paper


@dataclass(frozen=True, eq=False)
class Dataset:
    """Training and validation segments, and their maps."""

    train: Segments  # segments to train on
    val: Segments  # segments to validate with
    ground: Ground  # the maps of all segments


def make_dataset(
    scenes: Sequence[Scene],
    config: Config,
    *,
    val_fraction: float = VAL_FRACTION,
    val_scenes: Sequence[Scene] = (),
    segment_steps: int | None = None,
    progress: Progress = notebook_progress,
) -> Dataset:
    """Cut scenes of any places into a dataset; no segment lies in both of its parts.

    Args:
        scenes: scenes with the config's dt; scenes of one place hold the same `Ground` object.
        config: the model's configuration: its agent kind and its view.
        val_fraction: share of each scene's steps, at its end, for validation.
        val_scenes: scenes to validate with, whole; if there are any, the others are for training
            alone.
        segment_steps: length of a segment; None: 40 for vehicles and 30 for pedestrians.
        progress: takes stage, done and total.

    Returns:
        Segments of all scenes, and one ground of all their maps.

    Raises:
        TracksError: no agent of the kind is present for long enough, in either part.
    """
    grounds = {id(scene.ground): scene.ground for scene in (*scenes, *val_scenes)}
    place_of = {key: place for place, key in enumerate(grounds)}
    parts: dict[str, list[Segments]] = {name: [] for name in PARTS}
    problems: dict[str, list[str]] = {name: [] for name in parts}
    pieces = _list_pieces(scenes, val_scenes, val_fraction)
    for number, (name, source, piece) in enumerate(pieces):
        progress("segments", number, len(pieces))
        try:
            segments = cut_moving_and_parked(piece, config, segment_steps)
        except TracksError as error:
            problems[name].append(f"no {name} segments in {source}: {error}")
        else:
            places = segments.places + place_of[id(piece.ground)]
            parts[name].append(replace(segments, places=places))
    progress("segments", len(pieces), len(pieces))
    least = 2 * (segment_steps or SEGMENT_STEPS[config.kind]) * config.dt  # one in each part
    longest = max(len(scene.times) * scene.dt for scene in scenes)
    _report_problems(parts, problems, _advise(math.nan if val_scenes else longest, least))
    ground = stack_maps(list(grounds.values()), config.view)
    return Dataset(concat(parts["training"]), concat(parts["validation"]), ground)


def stack_maps(grounds: Sequence[Ground], view: View) -> Ground:
    """Prefilter the maps of places for a model's view, and put them into one ground.

    Maps are numbered as in `Segments.places`.
    """
    averaged = [
        prefilter_ground(ground, view.resolution, density=MAP_DENSITY) for ground in grounds
    ]
    return stack_grounds(averaged)


def split_scene(scene: Scene, val_fraction: float) -> tuple[Scene, Scene]:
    """Split a scene into its beginning, and its end with `val_fraction` (0 to 1) of the steps."""
    first = round(len(scene.times) * (1 - val_fraction))
    return slice_scene(scene, slice(0, first)), slice_scene(scene, slice(first, None))


def cut_moving_and_parked(scene: Scene, config: Config, steps: int | None = None) -> Segments:
    """Cut segments of moving agents, and some of parked ones, which then are known to stay.

    Smoothed states, where a scene has them, are what a model learns to predict; those that were
    observed at each time have more noise, and are not known in the first second of an agent.

    Args:
        scene: a scene with the config's dt.
        config: the model's configuration: its agent kind.
        steps: length of a segment; None: that of the kind.

    Returns:
        Segments with one controlled agent each.

    Raises:
        TracksError: no moving agent of the kind is there for long enough.
    """
    steps, stride = steps or SEGMENT_STEPS[config.kind], SEGMENT_STRIDES[config.kind]
    if scene.smoothed:  # of agents that are surely known at some time
        present = scene.present & mark_sure(scene).any(dim=1, keepdim=True)
        scene = replace(scene, observed=scene.states, observed_sigma=None, present=present)
    moving = cut_segments(scene, config.kind, steps=steps, stride=stride)
    try:
        parked = cut_segments(scene, config.kind, steps=steps, stride=steps, parked=True)
    except TracksError:  # there are none
        return moving
    thinning = math.ceil(len(parked) / (PARKED_SHARE * len(moving)))
    return concat([moving, pick(parked, slice(None, None, thinning))])


def cut_beginnings(
    scenes: Sequence[Scene], config: Config, fraction: float, steps: int
) -> Segments | None:
    """Cut what comes before the last `fraction` of scenes as `cut_moving_and_parked` does.

    Returns:
        Segments of all agents; None where none is there for long enough.
    """
    parts = []
    for scene in scenes if fraction < 1.0 else ():
        try:
            parts.append(cut_moving_and_parked(split_scene(scene, fraction)[0], config, steps))
        except TracksError:
            continue
    return concat(parts) if parts else None


def hold_out_agents(segments: Segments) -> tuple[Segments, Segments]:
    """Split segments of single agents by agent: those to train on, and those to choose by.

    Every `HELD_OUT`-th agent is held out; a single agent is in both. Where
    names are not known, each segment counts as an agent.
    """
    column = segments.controlled.int().argmax(dim=1).tolist()
    names: list[str] | list[int] = list(range(len(segments)))
    if segments.ids:
        names = [row[agent] for row, agent in zip(segments.ids, column, strict=True)]
    order = {name: number for number, name in enumerate(dict.fromkeys(names))}
    held = torch.tensor([order[name] % HELD_OUT == HELD_OUT - 1 for name in names])
    if not held.any():
        held = torch.tensor([order[name] == len(order) - 1 for name in names])
    if held.all():
        return segments, segments
    return pick(segments, ~held), pick(segments, held)


def _list_pieces(
    scenes: Sequence[Scene], val_scenes: Sequence[Scene], val_fraction: float
) -> list[tuple[str, str, Scene]]:
    """List the pieces of scenes: the part of the dataset, what it is cut from, and the piece."""
    pieces: list[tuple[str, str, Scene]] = []
    for number, scene in enumerate(scenes):
        source = f"recording {number + 1} of {len(scenes)}"
        if val_scenes:
            pieces.append(("training", source, scene))
            continue
        source += f", whose last {100 * val_fraction:g} % are for validation"
        for name, part in zip(PARTS, split_scene(scene, val_fraction), strict=True):
            pieces.append((name, source, part))
    for number, scene in enumerate(val_scenes):
        source = f"recording {number + 1} of {len(val_scenes)} to validate with"
        pieces.append(("validation", source, scene))
    return pieces


def _advise(longest: float, least: float) -> str:
    """Advise what gives segments, by the longest recording (if split) and what is needed, s."""
    more = "film longer, or train on several recordings (a .csv with the columns aim and tracks)"
    if longest < least:
        return f"training and validation need {least:g} s, and these are {longest:.0f} s: {more}"
    if math.isnan(longest):
        return more
    share = f"{name_option('--val-fraction', 'val_fraction=')} 0.5 gives both parts half"
    return f"{share}; if that is too short as well, {more}"


def _report_problems(
    parts: dict[str, list[Segments]], problems: dict[str, list[str]], advice: str
) -> None:
    """Raise where a part is empty, and warn where a recording adds nothing to it."""
    for name, part in parts.items():
        if not part:
            raise TracksError(f"{problems[name][0]}. What helps: {advice}")
        for problem in problems[name]:
            warn(problem)
