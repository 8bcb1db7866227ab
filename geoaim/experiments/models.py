"""The models that experiments compare; each training has a folder, and is run once."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from geoaim.errors import ModelError
from geoaim.experiments.places import TRAIN, make_places
from geoaim.experiments.protocol import (
    PEDESTRIANS,
    TRAININGS,
    VEHICLES,
    VEHICLES_ON_AIM,
    make_places_dataset,
)
from geoaim.experiments.results import Workspace
from geoaim.prediction.checkpoints import read_model, read_state
from geoaim.prediction.config import Config, TrainConfig
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.itra import ITRA, BuildEncoder
from geoaim.prediction.networks import build_cnn
from geoaim.prediction.training import hash_weights, init_model, train
from geoaim.progress import Progress, no_progress


@dataclass(frozen=True)
class ModelSpec:
    """How a model is trained on synthetic places.

    Attributes:
        config: of the model.
        map_name: one of `MAPS`.
        lights: whether it is trained with traffic lights.
        seeds: number of trainings; several where seeds differ as much as what is compared.
    """

    config: Config
    map_name: str
    lights: bool = True
    seeds: int = 1


MODELS = {
    "vehicle_aim": ModelSpec(VEHICLES_ON_AIM, "aim", seeds=2),
    "vehicle_hdm": ModelSpec(VEHICLES, "hdm", seeds=2),
    "vehicle_no_map": ModelSpec(VEHICLES, "none"),
    "vehicle_aim_no_lights": ModelSpec(VEHICLES_ON_AIM, "aim", lights=False, seeds=2),
    "pedestrian_aim": ModelSpec(PEDESTRIANS, "aim", seeds=3),
    "pedestrian_hdm": ModelSpec(PEDESTRIANS, "hdm", seeds=3),
    "pedestrian_roads": ModelSpec(PEDESTRIANS, "roads"),
    "pedestrian_full": ModelSpec(PEDESTRIANS, "full"),
    "pedestrian_no_map": ModelSpec(PEDESTRIANS, "none"),
}


def train_all_seeds(name: str, workspace: Workspace) -> list[ITRA]:
    """Train one of `MODELS` with all its seeds, or read it from its folders."""
    return [train_model(name, workspace, seed=seed) for seed in range(MODELS[name].seeds)]


def train_model(name: str, workspace: Workspace, *, seed: int = 0) -> ITRA:
    """Train one of `MODELS` on synthetic places, or read it from its folder.

    Args:
        name: of the model.
        workspace: keeps places and models.
        seed: of the training; each has a folder of its own.

    Returns:
        The model.
    """
    spec, progress = MODELS[name], workspace.progress

    def load_dataset() -> Dataset:
        places = make_places(workspace.places, TRAIN[spec.config.kind], progress=progress)
        return make_places_dataset(
            places, spec.config, spec.map_name, lights=spec.lights, progress=progress
        )

    training = replace(TRAININGS[spec.config.kind], seed=seed)
    folder = workspace.models / label_seed(name, seed)
    return train_once(
        init_model(spec.config, seed=seed), training, load_dataset, folder, progress=progress
    )


def label_seed(name: str, seed: int) -> str:
    """Label the training of a model with a seed; the first one has the model's name alone."""
    return f"{name}_{seed}" if seed else name


def train_once(
    model: ITRA,
    training: TrainConfig,
    load_dataset: Callable[[], Dataset],
    folder: Path,
    *,
    build_encoder: BuildEncoder = build_cnn,
    progress: Progress = no_progress,
) -> ITRA:
    """Train a model, or read it from its folder when it is complete.

    Args:
        model: to begin with.
        training: its hyperparameters.
        load_dataset: is called when the model has to be trained.
        folder: of the training.
        build_encoder: of the model.
        progress: takes stage, done and total.

    Returns:
        The model as its file has it, with weights rounded to 16 bits.

    Raises:
        ModelError: the folder's model is of another training.
    """
    path = folder / "model.pt"
    if path.exists():
        state = read_state(folder / "checkpoint.pt")
        if state["training"] != asdict(training):
            raise ModelError(
                f"{path} is of another training, {state['training']}; delete its folder"
            )
        if state["config"] != asdict(model.config):
            raise ModelError(f"{path} has another config; delete its folder, or name another")
        if state["start"]["weights"] != hash_weights(model):
            raise ModelError(f"{path} began with other weights; delete its folder")
    else:
        train(model, training, load_dataset(), folder, progress=progress)
    return read_model(path, build_encoder=build_encoder)
