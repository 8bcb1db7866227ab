"""A plain network that sees neighbours, on the Stanford windows and the standard test part."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from benchmarks.data import find_data, require_data
from benchmarks.prediction.averages import average_seeds
from benchmarks.prediction.results import (
    Metrics,
    Workspace,
    compute_differences,
    compute_seed_means,
    write_results,
)
from benchmarks.prediction.stanford import DATA, STANFORD_SAMPLES, VAL_SCENES
from benchmarks.prediction.stanford_people import People, read_people, select_people
from benchmarks.prediction.windows import HISTORY_STEPS, WINDOW_STEPS, make_path_segments
from geoaim.prediction.metrics import Metric
from geoaim.prediction.networks import build_mlp
from geoaim.simulation.kinematics import agent_from_world

TEST_DATA = "tracks/sdd_trajnet_test"  # the standard test part, in the same form
HORIZON = WINDOW_STEPS - HISTORY_STEPS
WIDTH, OTHERS_WIDTH = 512, 64
FAR_M, FINE_M = 5.0, 0.02  # what inputs are scaled by: whole ways, and half a pixel
SEEDS = {"alone": 1, "neighbours": 3}  # the judged one has three
CHOSEN = "neighbours"  # on the validation scenes


@dataclass(frozen=True)
class Training:
    """Settings of a training, chosen on `VAL_SCENES`."""

    steps: int = 6000
    batch_size: int = 256
    learning_rate: float = 1e-3
    scale_jitter: float = 0.2
    noise_m: float = 0.005  # 0.02 m, and small moves not spread out, cost 3 % of minFDE
    annealing: float = 0.6  # share of the steps until only the best trajectory learns


TRAINING = Training()


@dataclass(frozen=True, eq=False)
class Inputs:
    """What the network sees and what comes, in the person's frame, metres."""

    past: Float[Tensor, "E t 2"]
    others: Float[Tensor, "E K 4"]
    future: Float[Tensor, "E P 2"]


class NeighboursMLP(nn.Module):
    """Two hidden layers from observed positions and neighbours to 20 whole trajectories."""

    def __init__(self, *, neighbours: bool) -> None:
        super().__init__()
        moves = 2 * (HISTORY_STEPS - 1)
        self.others = build_mlp(8, OTHERS_WIDTH, OTHERS_WIDTH) if neighbours else None
        inputs = 2 * moves + 1 + OTHERS_WIDTH * neighbours
        self.layers = build_mlp(inputs, WIDTH, STANFORD_SAMPLES * HORIZON * 2)

    def forward(self, inputs: Inputs) -> Float[Tensor, "E A P 2"]:
        """Predict A trajectories of P steps as offsets from constant velocity, metres."""
        past = inputs.past
        whole = (past[:, -1] - past[:, 0]).norm(dim=1, keepdim=True)
        features = [
            past[:, :-1].flatten(1) / FAR_M,
            _refine(past.diff(dim=1).flatten(1)),
            _refine(whole),
        ]
        if self.others is not None:
            features.append(self._encode(inputs.others))
        offsets = FAR_M * self.layers(torch.cat(features, dim=1))
        steps = torch.arange(1.0, HORIZON + 1)[:, None]  # (P, 1)
        straight = (past[:, -1] - past[:, -2])[:, None] * steps  # (E, P, 2)
        return offsets.view(len(past), -1, HORIZON, 2) + straight[:, None]

    def _encode(self, others: Float[Tensor, "E K 4"]) -> Float[Tensor, "E F"]:
        """The largest of each feature over the others; 0 without any."""
        assert self.others is not None
        known = others.nan_to_num()
        offsets, moves = known[..., :2], known[..., 2:]
        scaled = [offsets / FAR_M, offsets.asinh(), 2 * moves, _refine(moves)]
        features = self.others(torch.cat(scaled, dim=-1)).relu()
        return features.masked_fill(others[..., :1].isnan(), 0).amax(dim=1)


def _refine(moves: Float[Tensor, "*E"]) -> Float[Tensor, "*E"]:
    """Spread small moves, so that standing is told from starting."""
    return (moves / FINE_M).asinh() / 3


def run(workspace: Workspace) -> list[Path]:
    """Evaluate a plain network with and without neighbours on Stanford windows; return the files.

    The standard test part is judged where the folder of real data has it.
    """
    folder = require_data(DATA)
    names = [path.stem for path in sorted((folder / "windows").glob("*.csv"))]
    train = read_people(folder, [name for name in names if name not in VAL_SCENES], training=True)
    val, test = read_people(folder, VAL_SCENES, training=False), _find_test()
    trained: dict[str, list[Metrics]] = {}
    for name in SEEDS:
        networks = _train_all(train, workspace, name)
        trained[name] = [evaluate_network(network, val) for network in networks]
        if test is not None and name == CHOSEN:
            part = f"{name}, test part"
            trained[part] = [evaluate_network(network, test) for network in networks]
    metrics = {name: average_seeds(parts) for name, parts in trained.items()}
    settings = {
        "windows": len(val.paths),
        "test windows": len(test.paths) if test else 0,
        "training windows": len(train.paths),
        "samples": STANFORD_SAMPLES,
        "neighbours minus alone": compute_differences(metrics[CHOSEN], metrics["alone"]),
        "trainings": {name: compute_seed_means(parts) for name, parts in trained.items()},
    }
    return write_results("stanford_neighbours", metrics, settings, workspace.results)


def _find_test() -> People | None:
    """The standard test part, where it is."""
    data = find_data()
    folder = data / TEST_DATA if data else None
    if folder is None or not folder.is_dir():
        return None
    names = [path.stem for path in sorted((folder / "windows").glob("*.csv"))]
    return read_people(folder, names, training=False)


def _train_all(people: People, workspace: Workspace, name: str) -> list[NeighboursMLP]:
    """Networks of all seeds; what lies in the workspace is used again."""
    networks = []
    for seed in range(SEEDS[name]):
        path = workspace.models / f"stanford_{name}_{seed}.pt"
        neighbours = name == "neighbours"
        network = NeighboursMLP(neighbours=neighbours).eval()
        if not path.exists():
            workspace.progress(f"train {name}", seed, SEEDS[name])
            path.parent.mkdir(parents=True, exist_ok=True)
            trained = train_network(people, neighbours=neighbours, seed=seed, training=TRAINING)
            torch.save(trained.state_dict(), path)
        network.load_state_dict(torch.load(path, weights_only=True))
        networks.append(network)
    return networks


def train_network(
    people: People, *, neighbours: bool, seed: int, training: Training = TRAINING
) -> NeighboursMLP:
    """Train the network: the best trajectory and the best end learn, errors in pixels.

    Args:
        people: training windows.
        neighbours: whether it sees the others around.
        seed: seed of the weights and of the batches.
        training: the settings.

    Returns:
        The network.
    """
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = NeighboursMLP(neighbours=neighbours)
    rate = training.learning_rate
    optimiser = torch.optim.AdamW(network.parameters(), rate, weight_decay=0.01)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=training.steps + 1)
    typical = people.resolutions.mean()  # metres per pixel
    for step in range(training.steps):
        rows = torch.randint(len(people.paths), (training.batch_size,), generator=generator)
        some = select_people(people, rows)
        modes, future = _predict_variations(network, some, training, generator)
        errors = (modes - future[:, None]).norm(dim=-1) * (typical / some.resolutions)[
            :, None, None
        ]
        learning = _count_learning(step, training)
        best = errors.mean(dim=2).topk(learning, dim=1, largest=False).values
        ends = errors[..., -1].topk(learning, dim=1, largest=False).values
        optimiser.zero_grad()
        (best.mean() + ends.mean() / 2).backward()
        optimiser.step()
        schedule.step()
    return network.eval()


def _count_learning(step: int, training: Training) -> int:
    """How many trajectories learn: half of them at first, so that none stays away."""
    share = max(0.0, 1 - step / (training.annealing * training.steps))
    return max(1, round(STANFORD_SAMPLES * share / 2))


def _predict_variations(
    network: NeighboursMLP, people: People, training: Training, generator: torch.Generator
) -> tuple[Float[Tensor, "E A P 2"], Float[Tensor, "E P 2"]]:
    """Predict windows that are scaled, mirrored and noisy; return what comes, too."""
    count = len(people.paths)
    size = 1 + training.scale_jitter * (2 * torch.rand(count, 1, 1, generator=generator) - 1)
    side = 2.0 * torch.randint(2, (count, 1), generator=generator) - 1
    inputs = make_inputs(people.paths * size, people.others * size)
    flip = torch.stack([torch.ones_like(side), side], dim=-1)  # (E, 1, 2)
    past = inputs.past * flip
    past = past + training.noise_m * torch.randn(past.shape, generator=generator)
    inputs = Inputs(past, inputs.others * flip.tile(2), inputs.future * flip)
    return network(inputs), inputs.future


def make_inputs(paths: Float[Tensor, "E T 2"], others: Float[Tensor, "E K 4"]) -> Inputs:
    """Turn windows and others into each person's frame at the last observed step."""
    pose = make_path_segments(paths).states[:, 0, HISTORY_STEPS - 1]
    local = agent_from_world(pose[:, None], paths)
    turn = torch.cat([torch.zeros_like(pose[:, :2]), pose[:, 2:]], dim=1)[:, None]
    halves = [agent_from_world(turn, half) for half in (others[..., :2], others[..., 2:])]
    around = torch.cat(halves, dim=-1)
    return Inputs(local[:, :HISTORY_STEPS], around, local[:, HISTORY_STEPS:])


@torch.no_grad()
def evaluate_network(network: NeighboursMLP, people: People) -> dict[str, Metric]:
    """Compute minADE and minFDE of 20 trajectories, in pixels and in metres."""
    inputs = make_inputs(people.paths, people.others)
    errors = (network(inputs) - inputs.future[:, None]).norm(dim=-1)  # (B, A, P)
    best = {"minADE": errors.mean(dim=2), "minFDE": errors[..., -1]}
    metrics = {}
    for name, values in best.items():
        metres = values.amin(dim=1).double().numpy()
        pixels = metres / people.resolutions.double().numpy()
        metrics[f"{name}_px"] = Metric(pixels, np.ones(len(pixels)))
        metrics[f"{name}_m"] = Metric(metres, np.ones(len(metres)))
    return metrics
