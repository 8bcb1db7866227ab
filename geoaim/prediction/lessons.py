"""What models learn from: segments of recordings, all on one ground, with their ends held out."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

from geoaim.errors import GeoaimWarning, TracksError
from geoaim.prediction.atlas import make_atlas
from geoaim.prediction.itra import Config
from geoaim.prediction.segments import Segments, cut_segments, joined, shifted
from geoaim.progress import Progress, no_progress
from geoaim.simulation.ground import Ground
from geoaim.simulation.scene import Scene, scene_steps

STEPS = {"vehicle": 40, "pedestrian": 30}  # of a segment: 4 s and 12 s, as in the paper
STRIDES = {"vehicle": 20, "pedestrian": 5}  # steps from one segment's start to the next one's
HELD_OUT = 0.05  # share at each recording's end, as in the paper


@dataclass(frozen=True, eq=False)
class Lessons:
    """What to learn from, and what to check with, on one ground."""

    train: Segments
    valid: Segments
    ground: Ground


def make_lessons(
    scenes: Sequence[Scene],
    config: Config,
    *,
    held_out: float = HELD_OUT,
    progress: Progress = no_progress,
) -> Lessons:
    """Segments of scenes of any places; none reaches from what is learnt into what is held out.

    Args:
        scenes: at the config's steps; those of one place share its ground.
        config: whose segments, and how they will see the ground.
        held_out: share of each scene's steps, at its end, to check with.
        progress: takes stage, done and total.

    Raises:
        TracksError: nobody of the kind is there for long enough, in either part.
    """
    grounds = list({id(scene.ground): scene.ground for scene in scenes}.values())
    ground, offsets = make_atlas(grounds, config.view)
    places = {id(ground): offset for ground, offset in zip(grounds, offsets, strict=True)}
    parts: dict[str, list[Segments]] = {"learn from": [], "check with": []}
    whys: dict[str, list[str]] = {name: [] for name in parts}
    for number, scene in enumerate(scenes):
        progress("segments", number, len(scenes))
        for name, some in zip(parts, split(scene, held_out), strict=True):
            try:
                found = cut_segments(
                    some,
                    config.kind,
                    steps=STEPS[config.kind],
                    stride=STRIDES[config.kind],
                )
            except TracksError as error:
                whys[name].append(
                    f"nothing to {name} in recording {number + 1} of {len(scenes)}, whose last "
                    f"{100 * held_out:g} % are held out: {error}"
                )
            else:
                parts[name].append(shifted(found, places[id(scene.ground)]))
    progress("segments", len(scenes), len(scenes))
    for name, part in parts.items():
        if not part:
            raise TracksError(f"{whys[name][0]}. Give more tracks, or hold out another share")
        for why in whys[name]:
            warnings.warn(why, GeoaimWarning, stacklevel=2)
    learnt, checked = (joined(part) for part in parts.values())
    return Lessons(learnt, checked, ground)


def split(scene: Scene, end: float) -> tuple[Scene, Scene]:
    """A scene without so much of its end, and that end: a share of its steps."""
    edge = round(len(scene.times) * (1 - end))
    return scene_steps(scene, slice(0, edge)), scene_steps(scene, slice(edge, None))
