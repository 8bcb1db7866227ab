"""A network without map or recurrence on the Stanford windows; maps where no ground is shared."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from benchmarks.data import require_data
from benchmarks.prediction.averages import average_seeds, bootstrap_trainings
from benchmarks.prediction.results import Metrics, Workspace, write_results
from benchmarks.prediction.stanford import (
    DATA,
    MODELS,
    STANFORD_SAMPLES,
    VAL_SCENES,
    read_scenes,
    train_on_scenes,
)
from benchmarks.prediction.windows import (
    HISTORY_STEPS,
    WINDOW_STEPS,
    WITHOUT_MAP,
    WindowFiles,
    Windows,
    evaluate_windows,
    make_window_predictor,
    read_windows,
    reverse_paths,
)
from benchmarks.prediction.windows import WINDOW_TRAINING as TRAINING
from geoaim.prediction.anchors import HISTORY_NOISE_M
from geoaim.prediction.baselines import BASELINES, Predictor
from geoaim.prediction.batches import compute_top_k
from geoaim.prediction.metrics import Metric
from geoaim.prediction.networks import build_mlp
from geoaim.prediction.segments import Segments, concat, repeat
from geoaim.rendering.ground import Ground
from geoaim.simulation.kinematics import agent_from_world, world_from_agent

VAL_PLACES = ("coupa", "gates", "hyang")  # no other place shows their ground
HORIZON = WINDOW_STEPS - HISTORY_STEPS
WIDTH, SCALE_M = 256, 5.0  # of the hidden layers; of the outputs, metres
SEEDS = 3
COMPARED = "map", "no map"  # models that are trained on the last split


class ModesMLP(nn.Module):
    """Two hidden layers from observed positions to 20 whole trajectories; winner takes all."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = build_mlp(2 * HISTORY_STEPS, WIDTH, STANFORD_SAMPLES * HORIZON * 2)

    def forward(
        self, pose: Float[Tensor, "E 4"], past: Float[Tensor, "E t 2"]
    ) -> Float[Tensor, "E A P 2"]:
        """Predict A trajectories of P steps in the world, as offsets from constant velocity.

        Args:
            pose: the last observed states.
            past: observed positions in the world, metres.

        Returns:
            Positions, metres.
        """
        local = agent_from_world(pose[:, None], past)  # (E, t, 2)
        offsets = SCALE_M * self.layers(local.flatten(1) / SCALE_M)
        steps = torch.arange(1.0, HORIZON + 1)[:, None]  # (P, 1)
        straight = (local[:, -1] - local[:, -2])[:, None] * steps  # (E, P, 2)
        modes = offsets.view(len(pose), -1, HORIZON, 2) + straight[:, None]
        return world_from_agent(pose[:, None, None], modes)


def make_predictor(network: ModesMLP) -> Predictor:
    """Make the predictor of a network: the modes, up to 20, of each window's pedestrian."""

    def predict(
        segments: Segments,
        ground: Ground,
        *,
        history: int,
        samples: int,
        generator: torch.Generator,
    ) -> Float[Tensor, "B K N T 4"]:
        with torch.no_grad():
            modes = network(segments.states[:, 0, history - 1], segments.states[:, 0, :history, :2])
        states = repeat(segments, samples).states.view(len(segments), samples, 1, WINDOW_STEPS, 4)
        states = states.clone()
        states[:, :, 0, history:, :2] = modes[:, :samples]
        return states

    return predict


@dataclass(frozen=True)
class _Split:
    """Scenes to train on, and others to evaluate on."""

    train: Sequence[str]
    val: Sequence[str]


def run(workspace: Workspace) -> list[Path]:
    """Evaluate a plain network and constant velocity on Stanford windows; return the files."""
    names = [path.stem for path in sorted((require_data(DATA) / "windows").glob("*.csv"))]
    away = [name for name in names if name.split("_")[0] in VAL_PLACES]
    splits = {
        "six scenes": _Split([name for name in names if name not in VAL_SCENES], VAL_SCENES),
        "three places": _Split([name for name in names if name not in away], away),
    }
    metrics: dict[str, Metrics] = {}
    for number, (title, split) in enumerate(splits.items()):
        workspace.progress("evaluate", number, len(splits))
        val = _read(split.val)
        networks = [train_modes(_read(split.train).segments, seed=seed) for seed in range(SEEDS)]
        predictors: dict[str, list[Predictor]] = {
            "MLP without map": [make_predictor(network) for network in networks],
            "constant velocity": [BASELINES["constant velocity"]],
            "constant velocity with noise": [BASELINES["constant velocity with noise"]],
        }
        for name, some in predictors.items():
            parts = [
                evaluate_windows(one, val, STANFORD_SAMPLES, progress=workspace.progress)
                for one in some
            ]
            metrics[f"{title}, {name}"] = average_seeds(parts)
    name, split = list(splits.items())[-1]
    trained = _train_models(split, workspace)
    metrics |= {f"{name}, {model}": average_seeds(parts) for model, parts in trained.items()}
    settings: dict[str, Any] = {
        name: {"train": one.train, "val": one.val} for name, one in splits.items()
    }
    settings |= {"samples": STANFORD_SAMPLES, "seeds": SEEDS}
    settings["map minus no map"] = _compare_by_scene(trained, split)
    return write_results("stanford_baselines", metrics, settings, workspace.results)


def _train_models(split: _Split, workspace: Workspace) -> dict[str, list[Metrics]]:
    """Metrics of the Stanford models with and without map, of each training."""
    metrics: dict[str, list[Metrics]] = {}
    for name in COMPARED:
        label = f"{name} away"
        models = [
            train_on_scenes(name, split.train, workspace, seed=seed, label=label)
            for seed in range(SEEDS)
        ]
        val = read_scenes(MODELS[name], split.val)
        metrics[name] = [
            evaluate_windows(
                make_window_predictor(model, STANFORD_SAMPLES),
                val,
                STANFORD_SAMPLES,
                progress=workspace.progress,
            )
            for model in models
        ]
    return metrics


def _compare_by_scene(trained: Mapping[str, list[Metrics]], split: _Split) -> dict[str, Any]:
    """Differences of the model with map and that without, over scenes and trainings."""
    scenes = np.array(_read(split.val).scenes)
    differences = {}
    for metric in ("minADE_px", "minFDE_px"):
        one, other = (
            [
                [
                    Metric(metrics[metric].sums[here], metrics[metric].counts[here])
                    for scene in split.val
                    for here in [scenes == scene]
                ]
                for metrics in trained[name]
            ]
            for name in COMPARED
        )
        differences[metric] = bootstrap_trainings(one, other)
    return differences


def train_modes(segments: Segments, *, seed: int) -> ModesMLP:
    """Train the network on windows, forwards and reversed, as the Stanford models are trained.

    Args:
        segments: training windows.
        seed: seed of the weights and of the batches.

    Returns:
        The network.
    """
    both = concat([segments, reverse_paths(segments)])
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = ModesMLP()
    optimiser = torch.optim.AdamW(network.parameters(), TRAINING.learning_rate, weight_decay=0.01)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, TRAINING.learning_rate, total_steps=TRAINING.steps + 1
    )
    for step in range(TRAINING.steps):
        rows = torch.randint(len(both), (TRAINING.batch_size,), generator=generator)
        loss = _compute_loss(network, both.states[rows, 0], step, generator)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    return network.eval()


def _compute_loss(
    network: ModesMLP, states: Float[Tensor, "E T 4"], step: int, generator: torch.Generator
) -> Float[Tensor, ""]:
    """The mean distance of the best modes, and half of that at their ends.

    Windows are scaled and their observed positions noisy, as for the Stanford models.
    """
    size = 1 + TRAINING.scale_jitter * (2 * torch.rand(len(states), 1, 1, generator=generator) - 1)
    paths = states[..., :2] * size
    pose = torch.cat([paths[:, HISTORY_STEPS - 1], states[:, HISTORY_STEPS - 1, 2:]], dim=1)
    past = paths[:, :HISTORY_STEPS]
    past = past + HISTORY_NOISE_M * torch.randn(past.shape, generator=generator)
    modes = network(pose, past)
    distances = (modes - paths[:, None, HISTORY_STEPS:]).norm(dim=-1)  # (E, A, P)
    top_k = compute_top_k(TRAINING, step, STANFORD_SAMPLES)
    best = distances.mean(dim=2).topk(top_k, dim=1, largest=False).values
    ends = distances[..., -1].topk(top_k, dim=1, largest=False).values
    return best.mean() + ends.mean() / 2


def _read(scenes: Sequence[str]) -> Windows:
    folder = require_data(DATA)
    files = WindowFiles(folder / "windows", None, folder / "scenes.csv")
    return read_windows(files, WITHOUT_MAP.view, scenes=scenes)
