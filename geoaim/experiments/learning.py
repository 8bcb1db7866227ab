"""Models of made places: what they learn from, and how they are judged."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from geoaim.errors import TracksError
from geoaim.experiments.places import read_map, read_recordings, scene_of
from geoaim.prediction.evaluation import Asked, evaluate
from geoaim.prediction.itra import ITRA, Config
from geoaim.prediction.lessons import HELD_OUT, STEPS, Lessons, make_lessons, split
from geoaim.prediction.metrics import Measure, merged
from geoaim.prediction.predict import OBSERVED
from geoaim.prediction.segments import cut_segments
from geoaim.prediction.training import from_scratch
from geoaim.progress import Progress, no_progress
from geoaim.simulation.episodes import NO_RULES, Rules
from geoaim.simulation.ground import fit_ground
from geoaim.simulation.scene import Scene

# bars of lights that are one pixel wide are never learnt
VEHICLES = Config("vehicle", "bicycle", seconds=0.1, size=48, resolution=1.0, bar=8.0, every=5)
LIKENESS = replace(VEHICLES, unlike=True)  # tar mostly leads on over tar of the same colour
PEOPLE = Config("pedestrian", "unicycle", seconds=0.4, size=48, resolution=0.5, every=3, lever=0.25)
SAMPLES = 6
TRAININGS = {
    "vehicle": from_scratch("vehicle", steps=1600, batch=48),
    "pedestrian": from_scratch("pedestrian", steps=900, batch=48),
}


def lessons_of(
    folders: Sequence[Path],
    config: Config,
    name: str,
    *,
    lights: bool = True,
    held_out: float = HELD_OUT,
    report: Progress = no_progress,
) -> Lessons:
    """Segments of made places on one of their maps; ends of recordings are for validation."""
    scenes: list[Scene] = []
    for number, folder in enumerate(folders):
        report("places", number, len(folders))
        aim = read_map(folder, name)
        found = [
            scene_of(recorded, aim, rate=1 / config.seconds, lights=lights)
            for recorded in read_recordings(folder)
        ]
        scenes += [replace(scene, ground=found[0].ground) for scene in found]
    return make_lessons(scenes, config, held_out=held_out, progress=report)


def judge(
    model: ITRA | str,
    folders: Sequence[Path],
    config: Config,
    name: str,
    *,
    end: float = 1.0,
    lights: bool = True,
) -> dict[str, Measure]:
    """Measures of a model or a baseline, all of the kind jointly, on so much of each end."""
    parts = [
        part
        for folder in folders
        for part in judge_at(model, folder, config, name, end=end, lights=lights)
    ]
    if not parts:
        raise TracksError(
            f"no {config.kind} is there for {STEPS[config.kind]} steps in {len(folders)} places"
        )
    return merged(parts)


def judge_at(
    model: ITRA | str, folder: Path, config: Config, name: str, *, end: float, lights: bool
) -> list[dict[str, Measure]]:
    """Measures at one place, of each recording in which somebody is there for long enough."""
    asked = Asked(OBSERVED, SAMPLES, lights=lights)
    aim, parts = read_map(folder, name), []
    for recorded in read_recordings(folder):
        _, scene = split(scene_of(recorded, aim, rate=1 / config.seconds), end)
        rules = recorded.rules if config.kind == "vehicle" else NO_RULES
        # every other piece is enough to judge
        stride = 2 * STEPS[config.kind]
        parts += judged(model, scene, config, asked, stride=stride, rules=rules)
    return parts


def judged(
    model: ITRA | str,
    scene: Scene,
    config: Config,
    asked: Asked,
    *,
    stride: int,
    rules: Rules = NO_RULES,
) -> list[dict[str, Measure]]:
    """Measures on joint pieces of a scene; none where nobody is there for so long."""
    try:
        segments = cut_segments(
            scene, config.kind, steps=STEPS[config.kind], stride=stride, joint=True
        )
    except TracksError:
        return []
    ground = fit_ground(scene.ground, config.resolution)
    return [evaluate(model, segments, ground, asked, rules=rules)]
