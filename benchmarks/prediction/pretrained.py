"""The models that come with the package: their training, and their evaluation at test places.

Two stages: on clean maps and exact tracks, as the tables of the paper have them; then on the same
places with standing agents, detection noise, and maps of all sorts (`realistic`). Vehicles have a
third one, in which they drive on from where they have brought themselves (`closed_loop`).
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

from benchmarks.prediction.closed_loop import make_closed_loop
from benchmarks.prediction.models import train_model, train_once
from benchmarks.prediction.places import TEST, TRAIN, Places, make_places
from benchmarks.prediction.protocol import PEDESTRIANS, VEHICLES
from benchmarks.prediction.realistic import make_realistic_dataset
from benchmarks.prediction.results import Workspace, write_results
from benchmarks.prediction.tables import Case, evaluate_case
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.checkpoints import write_model
from geoaim.prediction.config import TrainConfig, configure_fine_tuning
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.itra import ITRA

# places whose minADE decides which step of the second stage is kept; in neither `TRAIN` nor `TEST`
_VAL_ROADS: Places = ((401, "junction"), (402, "t"), (405, "roundabout"), (406, "street"))
VAL: dict[str, Places] = {
    "vehicle": (*_VAL_ROADS, (403, "campus")),
    "pedestrian": (*_VAL_ROADS, (404, "park")),
}
# vehicles: about half an hour of one core
REALISTIC_STEPS = {"vehicle": 5000, "pedestrian": 1000}
REALISTIC_BATCH, REALISTIC_RATE = 48, 1e-3
CHECKPOINT_INTERVAL = 150  # steps
# standard deviation of latents in samples, by joint minADE and standing agents at `VAL`
LATENT_SCALES = {"vehicle": 0.8, "pedestrian": 1.0}
COLOUR_JITTER, MAP_SHIFT_M, MAP_SCALE = 0.15, 1.5, 0.04


def run(workspace: Workspace) -> list[Path]:
    """Train and test the two pretrained models at synthetic places; return the files."""
    written, metrics = [], {}
    for config in (VEHICLES, PEDESTRIANS):
        kind, name = config.kind, f"{config.kind}_aim"
        places = make_places(workspace.places, TEST[kind], progress=workspace.progress)
        model = make_realistic(train_model(name, workspace), workspace)
        model.config = replace(model.config, latent_scale=LATENT_SCALES[kind])
        if kind == "vehicle":
            folder = workspace.models / "vehicle_closed_loop"
            model = make_closed_loop(model, folder, workspace.progress)
        written.append(workspace.folder / "pretrained" / f"{kind}.pt")
        write_model(model, written[-1])
        metrics[f"{kind}s, ITRA"] = evaluate_case(model.sample, Case(name, "aim"), config, places)
        for rule, predictor in BASELINES.items():
            case = Case(rule, "none")
            metrics[f"{kind}s, {rule}"] = evaluate_case(predictor, case, config, places)
    settings = {
        "training places": TRAIN,
        "validation places of the second stage": VAL,
        "test places": TEST,
    }
    return [*written, *write_results("pretrained", metrics, settings, workspace.results)]


def make_realistic(model: ITRA, workspace: Workspace) -> ITRA:
    """Fine-tune a model on places as they are recorded, or read it from its folder."""
    kind = model.config.kind
    training = configure_realistic(kind)
    load = partial(_load_dataset, model, workspace)
    return train_once(model, training, load, f"{kind}_realistic", workspace)


def configure_realistic(kind: str) -> TrainConfig:
    """Configure the second stage of a kind of model."""
    training = configure_fine_tuning(kind, steps=REALISTIC_STEPS[kind], batch_size=REALISTIC_BATCH)
    return replace(
        training,
        learning_rate=REALISTIC_RATE,
        checkpoint_interval=CHECKPOINT_INTERVAL,
        colour_jitter=COLOUR_JITTER,
        map_shift=MAP_SHIFT_M,
        map_scale=MAP_SCALE,
    )


def _load_dataset(model: ITRA, workspace: Workspace) -> Dataset:
    kind, progress = model.config.kind, workspace.progress
    train, val = (
        make_places(workspace.places, places[kind], progress=progress) for places in (TRAIN, VAL)
    )
    return make_realistic_dataset(train, val, model.config, progress=progress)
