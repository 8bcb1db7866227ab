"""Ablations of choices that the paper leaves open: short trainings that differ in one of them."""

from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import nn

from geoaim.experiments.models import train_once
from geoaim.experiments.places import TRAIN, make_places
from geoaim.experiments.protocol import SAMPLES, VEHICLES, make_places_dataset
from geoaim.experiments.resnet import build_resnet18
from geoaim.experiments.results import Workspace, compute_differences, write_results
from geoaim.prediction.config import MAX_HISTORY_STEPS, Config, TrainConfig, configure_training
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.evaluation import EvalConfig, evaluate
from geoaim.prediction.itra import ITRA, BuildEncoder
from geoaim.prediction.metrics import Metric
from geoaim.prediction.networks import build_cnn
from geoaim.prediction.segments import pick

STEPS, BATCH_SIZE = 250, 32
VAL_STRIDE = 6  # every sixth validation segment is evaluated
METRICS = ("minADE", "minFDE", "MFD")


@dataclass(frozen=True)
class Ablation:
    """What differs from the default.

    Attributes:
        config: configuration of the model.
        kl_weight: weight of the KL term in the loss.
        build_encoder: builds the model's encoder of views.
        default_weights: whether convolutions start with torch's default weights.
    """

    config: Config = VEHICLES
    kl_weight: float = TrainConfig.kl_weight
    build_encoder: BuildEncoder = build_cnn
    default_weights: bool = False


ABLATIONS = {
    "vehicles": Ablation(),
    "vehicles, KL weight 1": Ablation(kl_weight=1.0),
    "vehicles, KL weight 0.3": Ablation(kl_weight=0.3),
    "vehicles, torch's initial weights": Ablation(default_weights=True),
    "vehicles, no view": Ablation(replace(VEHICLES, use_observations=False)),
    "vehicles, ResNet-18": Ablation(build_encoder=build_resnet18),
}


def run(workspace: Workspace) -> list[Path]:
    """Choices that the paper leaves open, by short trainings on synthetic places."""
    progress = workspace.progress
    places = make_places(workspace.places, TRAIN["vehicle"], progress=progress)
    dataset = make_places_dataset(places, VEHICLES, "aim", progress=progress)
    val = pick(dataset.val, slice(None, None, VAL_STRIDE))
    options = EvalConfig(MAX_HISTORY_STEPS, SAMPLES)
    table: dict[str, dict[str, Metric]] = {}
    for name, ablation in ABLATIONS.items():
        model = _train(name, ablation, dataset, workspace)
        metrics = evaluate(model.sample, val, dataset.ground, options, progress=progress)
        table[name] = {key: metrics[key] for key in METRICS}
    settings = {
        "steps": STEPS,
        "batch size": BATCH_SIZE,
        "segments": len(val),
        "evaluated on": "ends of the recordings of training places",
        "difference from the first row": {
            name: compute_differences(table[name], table["vehicles"])
            for name in ABLATIONS
            if name != "vehicles"
        },
    }
    return write_results("ablations", table, settings, workspace.results)


def _train(name: str, ablation: Ablation, dataset: Dataset, workspace: Workspace) -> ITRA:
    config, build_encoder = ablation.config, ablation.build_encoder
    training = configure_training(config.kind, steps=STEPS, batch_size=BATCH_SIZE)
    training = replace(training, kl_weight=ablation.kl_weight)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(training.seed)
        model = ITRA(config, build_encoder)
        if ablation.default_weights:
            _reset_convolutions(model)
    label = name.replace(",", "").replace(" ", "_")
    return train_once(
        model,
        training,
        lambda: dataset,
        workspace.models / "ablations" / label,
        build_encoder=build_encoder,
        progress=workspace.progress,
    )


def _reset_convolutions(model: ITRA) -> None:
    """Give convolutions torch's default initial weights."""
    for module in model.encoder.modules():
        if isinstance(module, nn.Conv2d):
            module.reset_parameters()
