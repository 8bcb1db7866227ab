"""Models of made places: what they learn from, and how they are judged."""

from collections.abc import Sequence
from pathlib import Path

from geoaim.errors import TracksError
from geoaim.experiments.places import read_map, read_recordings, scene_of
from geoaim.prediction.atlas import make_atlas
from geoaim.prediction.evaluation import Asked, evaluate
from geoaim.prediction.itra import ITRA, Config
from geoaim.prediction.metrics import Measure, merged
from geoaim.prediction.predict import OBSERVED
from geoaim.prediction.segments import Segments, cut_segments, joined, shifted
from geoaim.prediction.training import Lessons, Training
from geoaim.progress import Progress, silent
from geoaim.simulation.ground import fit_ground
from geoaim.simulation.scene import Scene, ground_of

VEHICLES = Config("vehicle", "bicycle", seconds=0.1, size=48, resolution=1.0, every=5)
PEOPLE = Config("pedestrian", "unicycle", seconds=0.4, size=48, resolution=0.5, every=3, lever=0.25)
STEPS = {"vehicle": 40, "pedestrian": 30}  # of a segment: 4 s and 12 s, as in the paper
SAMPLES = 6
STRIDES = {"vehicle": 20, "pedestrian": 5}  # steps between segments that are learnt from
TRAININGS = {
    "vehicle": Training(steps=1000, batch=48, divergence=0.3),
    "pedestrian": Training(steps=1200, batch=48, divergence=0.3, mirror=True),
}


def make_lessons(
    folders: Sequence[Path],
    config: Config,
    name: str,
    *,
    lights: bool = True,
    report: Progress = silent,
) -> Lessons:
    """Segments of made places on one of their maps; ends of recordings are for validation."""
    found: dict[str, list[tuple[int, Segments]]] = {"first": [], "last": []}
    grounds = []
    for number, folder in enumerate(folders):
        report("segments", number, len(folders))
        aim = read_map(folder, name)
        grounds.append(ground_of(aim))
        for recorded in read_recordings(folder):
            for part, segments in found.items():
                scene = scene_of(recorded, aim, rate=1 / config.seconds, part=part, lights=lights)
                segments += [(number, some) for some in _cut(scene, config)]
    report("segments", len(folders), len(folders))
    ground, offsets = make_atlas(grounds, config.view)
    train, valid = (
        joined([shifted(some, offsets[number]) for number, some in segments])
        for segments in found.values()
    )
    return Lessons(train, valid, ground)


def judge(
    model: ITRA | str,
    folders: Sequence[Path],
    config: Config,
    name: str,
    *,
    part: str = "all",
    lights: bool = True,
) -> dict[str, Measure]:
    """Measures of a model or a baseline, all of the kind jointly, on some part of recordings."""
    asked = Asked(OBSERVED, SAMPLES, lights=lights)
    parts = []
    for folder in folders:
        aim = read_map(folder, name)
        for recorded in read_recordings(folder):
            scene = scene_of(recorded, aim, rate=1 / config.seconds, part=part)
            for segments in _cut(scene, config, joint=True):
                ground = fit_ground(scene.ground, config.resolution)
                parts.append(evaluate(model, segments, ground, asked, rules=recorded.rules))
    return merged(parts)


def _cut(scene: Scene, config: Config, *, joint: bool = False) -> list[Segments]:
    """The segments of a scene; none where nobody of the kind is there for so long."""
    steps = STEPS[config.kind]
    stride = 2 * steps if joint else STRIDES[config.kind]  # every other piece is enough to judge
    try:
        return [cut_segments(scene, config.kind, steps=steps, stride=stride, joint=joint)]
    except TracksError:
        return []
