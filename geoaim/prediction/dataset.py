"""Datasets: training and validation segments of recordings, all on one ground."""

from collections.abc import Sequence
from dataclasses import dataclass

from geoaim.errors import TracksError, warn
from geoaim.prediction.atlas import make_atlas
from geoaim.prediction.config import SEGMENT_STEPS, SEGMENT_STRIDES, Config
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.segments import Segments, concat, shift
from geoaim.progress import Progress, notebook_progress
from geoaim.simulation.ground import Ground
from geoaim.simulation.scene import Scene, slice_scene

VAL_FRACTION = 0.05  # share of each recording, at its end, as in the paper


@dataclass(frozen=True, eq=False)
class Dataset:
    """Training and validation segments on one ground."""

    train: Segments  # segments to train on
    val: Segments  # segments to validate with
    ground: Ground  # the map of all segments


def make_dataset(
    scenes: Sequence[Scene],
    config: Config,
    *,
    val_fraction: float = VAL_FRACTION,
    progress: Progress = notebook_progress,
) -> Dataset:
    """Cut scenes of any places into a dataset; no segment lies in both of its parts.

    Args:
        scenes: at the config's dt; scenes of one place hold the same `Ground` object.
        config: of the model: its agent kind ("vehicle" or "pedestrian") and its view.
        val_fraction: share of each scene's steps, at its end, for validation.
        progress: takes stage, done and total.

    Returns:
        Segments of all scenes, shifted to their places in an atlas of all grounds.

    Raises:
        TracksError: no agent of the kind is present for long enough, in either part.
    """
    grounds = list({id(scene.ground): scene.ground for scene in scenes}.values())
    atlas, offsets = make_atlas(grounds, config.view)
    offset_of = {id(ground): offset for ground, offset in zip(grounds, offsets, strict=True)}
    parts: dict[str, list[Segments]] = {"training": [], "validation": []}
    problems: dict[str, list[str]] = {name: [] for name in parts}
    for number, scene in enumerate(scenes):
        progress("segments", number, len(scenes))
        for name, part in zip(parts, split_scene(scene, val_fraction), strict=True):
            try:
                segments = cut_segments(
                    part,
                    config.kind,
                    steps=SEGMENT_STEPS[config.kind],
                    stride=SEGMENT_STRIDES[config.kind],
                )
            except TracksError as error:
                problems[name].append(
                    f"no {name} segments in recording {number + 1} of {len(scenes)}, whose last "
                    f"{100 * val_fraction:g} % are for validation: {error}"
                )
            else:
                parts[name].append(shift(segments, offset_of[id(scene.ground)]))
    progress("segments", len(scenes), len(scenes))
    _report_problems(parts, problems)
    return Dataset(concat(parts["training"]), concat(parts["validation"]), atlas)


def split_scene(scene: Scene, val_fraction: float) -> tuple[Scene, Scene]:
    """Split a scene into its beginning, and its end with `val_fraction` (0 to 1) of the steps."""
    first = round(len(scene.times) * (1 - val_fraction))
    return slice_scene(scene, slice(0, first)), slice_scene(scene, slice(first, None))


def _report_problems(parts: dict[str, list[Segments]], problems: dict[str, list[str]]) -> None:
    """Raise where a part is empty, and warn where a recording adds nothing to it."""
    for name, part in parts.items():
        if not part:
            raise TracksError(
                f"{problems[name][0]}. Give longer tracks, or another share for validation"
            )
        for problem in problems[name]:
            warn(problem)
