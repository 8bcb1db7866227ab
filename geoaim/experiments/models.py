"""The models that experiments compare; each training is kept in its folder."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from geoaim.errors import ModelError
from geoaim.experiments.learning import LIKENESS, PEOPLE, TRAININGS, VEHICLES, lessons_of
from geoaim.experiments.places import TRAIN, make_places
from geoaim.prediction.checkpoints import kept_model, read_state
from geoaim.prediction.itra import ITRA, Config
from geoaim.prediction.lessons import Lessons
from geoaim.prediction.training import Training, digest, train
from geoaim.progress import Progress, no_progress


@dataclass(frozen=True)
class Recipe:
    """What a model is made of, what it sees, and how often it is trained.

    Attributes:
        config: of the model.
        map: one of `MAPS`.
        lights: whether they are shown.
        trainings: more than one where chance may be as large as what is asked.
    """

    config: Config
    map: str
    lights: bool = True
    trainings: int = 1


RECIPES = {
    "vehicle_aim": Recipe(LIKENESS, "aim", trainings=2),
    "vehicle_hdm": Recipe(VEHICLES, "hdm", trainings=2),
    "vehicle_no_map": Recipe(VEHICLES, "none"),
    "vehicle_aim_no_lights": Recipe(LIKENESS, "aim", lights=False, trainings=2),
    "pedestrian_aim": Recipe(PEOPLE, "aim", trainings=3),
    "pedestrian_hdm": Recipe(PEOPLE, "hdm", trainings=3),
    "pedestrian_roads": Recipe(PEOPLE, "roads"),
    "pedestrian_full": Recipe(PEOPLE, "full"),
    "pedestrian_no_map": Recipe(PEOPLE, "none"),
}


def all_trained(name: str, folder: Path, *, report: Progress = no_progress) -> list[ITRA]:
    """Every training of one of `RECIPES`."""
    seeds = range(RECIPES[name].trainings)
    return [trained(name, folder, seed=seed, report=report) for seed in seeds]


def trained(name: str, folder: Path, *, seed: int = 0, report: Progress = no_progress) -> ITRA:
    """One of `RECIPES`, from its folder; trained, or trained on, where it is not whole yet.

    Args:
        name: of the recipe.
        folder: where places and models are kept.
        seed: of its training; each has a folder of its own.
        report: takes stage, done and total.
    """
    recipe = RECIPES[name]

    def lessons() -> Lessons:
        places = make_places(folder / "places", TRAIN[recipe.config.kind], report=report)
        return lessons_of(places, recipe.config, recipe.map, lights=recipe.lights, report=report)

    training = replace(TRAININGS[recipe.config.kind], seed=seed)
    where = training_folder(folder, name, seed)
    return kept_or_trained(where, recipe.config, training, lessons, report)


def training_folder(folder: Path, label: str, seed: int) -> Path:
    """Where a training of a model is kept; the first one's folder has the model's label alone."""
    return folder / "models" / (f"{label}_{seed}" if seed else label)


def kept_or_trained(
    where: Path,
    config: Config,
    training: Training,
    lessons: Callable[[], Lessons],
    report: Progress,
    start: ITRA | None = None,
) -> ITRA:
    """The model in a folder; trained, or trained on, where it is not whole yet.

    Always as its file has it, so that what starts from it is the same in a later run.

    Raises:
        ModelError: the folder's was trained otherwise, or from other weights.
    """
    kept = where / "model.pt"
    if kept.exists():
        state = read_state(where / "checkpoint.pt")
        how = state["training"]
        if how != asdict(training):
            raise ModelError(f"{kept} was trained otherwise, {how}; delete its folder")
        if state["start"]["weights"] != digest(start):
            raise ModelError(f"{kept} began with other weights; delete its folder")
    else:
        train(config, training, lessons(), where, start=start, progress=report)
    return kept_model(kept, config)
