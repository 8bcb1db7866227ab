"""The models that experiments compare; each training has a folder, and is run once."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from benchmarks.prediction.places import TRAIN, make_places
from benchmarks.prediction.protocol import (
    PEDESTRIANS,
    TRAININGS,
    VEHICLES,
    VEHICLES_ON_AIM,
    make_places_dataset,
)
from benchmarks.prediction.results import Workspace
from geoaim.base.errors import ModelError
from geoaim.prediction.checkpoints import read_model, read_state
from geoaim.prediction.config import Config, TrainConfig
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.itra import ITRA
from geoaim.prediction.training import hash_weights, init_model, train


@dataclass(frozen=True)
class _ModelSpec:
    """How a model is trained on synthetic places."""

    config: Config  # configuration of the model
    map_name: str  # one of `MAPS`
    lights: bool = True  # whether it is trained with traffic lights
    seeds: int = 1  # number of trainings; several where seeds differ as much as what is compared


MODELS = {
    "vehicle_aim": _ModelSpec(VEHICLES_ON_AIM, "aim", seeds=2),
    "vehicle_hdm": _ModelSpec(VEHICLES, "hdm", seeds=2),
    "vehicle_no_map": _ModelSpec(VEHICLES, "none"),
    "vehicle_aim_no_lights": _ModelSpec(VEHICLES_ON_AIM, "aim", lights=False, seeds=2),
    "pedestrian_aim": _ModelSpec(PEDESTRIANS, "aim", seeds=3),
    "pedestrian_hdm": _ModelSpec(PEDESTRIANS, "hdm", seeds=3),
    "pedestrian_full": _ModelSpec(PEDESTRIANS, "full"),
    "pedestrian_no_map": _ModelSpec(PEDESTRIANS, "none"),
}


def train_all_seeds(name: str, workspace: Workspace) -> list[ITRA]:
    """Train one of `MODELS` with all its seeds, or read it from its folders."""
    return [train_model(name, workspace, seed=seed) for seed in range(MODELS[name].seeds)]


def train_model(name: str, workspace: Workspace, *, seed: int = 0) -> ITRA:
    """Train one of `MODELS` on synthetic places, or read it from its folder.

    Args:
        name: name of the model.
        workspace: keeps places and models.
        seed: seed of the training; each seed has a folder of its own.

    Returns:
        The model.
    """
    spec, progress = MODELS[name], workspace.progress
    kind = spec.config.kind

    def load_dataset() -> Dataset:
        places = make_places(workspace.places, TRAIN[kind], progress=progress)
        return make_places_dataset(
            places, spec.config, spec.map_name, lights=spec.lights, progress=progress
        )

    model, training = init_model(spec.config, seed=seed), replace(TRAININGS[kind], seed=seed)
    return train_once(model, training, load_dataset, name, workspace)


def train_once(
    model: ITRA,
    training: TrainConfig,
    load_dataset: Callable[[], Dataset],
    name: str,
    workspace: Workspace,
) -> ITRA:
    """Train a model, or read it from its folder when it is complete.

    Args:
        model: the model to start from.
        training: its hyperparameters.
        load_dataset: is called when the model has to be trained.
        name: name of the folder; seeds other than 0 are appended.
        workspace: keeps the folder.

    Returns:
        The model as its file has it, with weights rounded to 16 bits.

    Raises:
        ModelError: the folder's model is of another training.
    """
    folder = name_training(name, training.seed, workspace)
    path = folder / "model.pt"
    if path.exists():
        state = read_state(folder / "checkpoint.pt")
        for part, found, wanted in (
            ("training", state["training"], asdict(training)),
            ("config", state["config"], asdict(model.config)),
            ("start", state["start"]["weights"], hash_weights(model)),
        ):
            if found != wanted:
                raise ModelError(f"{path} has another {part}, {found}; delete its folder")
    else:
        train(model, training, load_dataset(), folder, progress=workspace.progress)
    return read_model(path)


def name_training(name: str, seed: int, workspace: Workspace) -> Path:
    """Name the folder of a training.

    Args:
        name: name of what is trained.
        seed: seed of the training.
        workspace: keeps the folder.

    Returns:
        The folder.
    """
    return workspace.models / (f"{name}_{seed}" if seed else name)
