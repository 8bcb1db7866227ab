"""Training: a plain loop that resumes after an interruption with the same result."""

import copy
import csv
import hashlib
import math
import os
import time
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import nn
from torch.nn.parallel import DistributedDataParallel

from geoaim.base.defaults import SAMPLES
from geoaim.base.errors import ModelError
from geoaim.base.files import atomic_files, lock_folder
from geoaim.base.limits import refuse_damaged
from geoaim.base.progress import Progress, notebook_progress
from geoaim.prediction.baselines import Predictor
from geoaim.prediction.batches import compute_top_k, draw_batch, join_processes, share_weights
from geoaim.prediction.bound import Losses
from geoaim.prediction.checkpoints import read_state, write_model, write_state
from geoaim.prediction.config import MAX_HISTORY_STEPS, Config, TrainConfig
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.familiarity import learn_known_views
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import compute_ade
from geoaim.prediction.plain import train_plain
from geoaim.prediction.predict import draw_covering
from geoaim.prediction.segments import Segments, move_to, pick
from geoaim.rendering.ground import Ground

MAX_VAL_SEGMENTS = 256  # segments that are predicted for the log
ANCHOR_WEIGHT = 12.0  # weight of an error in metres beside a negative log-likelihood
MAX_GRADIENT_NORM = 1.0
Weights = dict[str, torch.Tensor]
LOG_COLUMNS = ("step", "nll", "kl", "anchor", "val_loss", "minADE", "segments_per_s")


@dataclass(frozen=True, eq=False)
class _Parts:
    """What a checkpoint holds."""

    model: ITRA
    optimiser: torch.optim.AdamW
    scheduler: torch.optim.lr_scheduler.OneCycleLR


def init_model(config: Config, *, seed: int = 0) -> ITRA:
    """Make a new model on the CPU, whose random weights follow from a seed."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return ITRA(config)


def train(
    model: ITRA,
    config: TrainConfig,
    dataset: Dataset,
    folder: str | os.PathLike[str],
    *,
    progress: Progress = notebook_progress,
) -> ITRA:
    """Train a model on the device of the dataset's ground, or resume the folder's training.

    The model that is kept is that of the validated step with the lowest minADE, as `find_best_step`
    tells from the log; with `config.log_start`, that may be the model to start from.

    Writes `checkpoint.pt`, `log.csv` and, at the end, `model.pt`. On a CPU, with the same number of
    threads, the same seed gives the same weights, interrupted or not. Processes of `torchrun` share
    each batch.

    Args:
        model: the model to start from, from `init_model` or `read_model`; it is not changed.
        config: hyperparameters of the training.
        dataset: training and validation segments.
        folder: folder in which the files are written.
        progress: takes stage, done and total.

    Returns:
        The trained model, in evaluation mode.

    Raises:
        ModelError: the folder holds another training, its checkpoint cannot be read, or the loss
            is not finite.
        ValueError: another process trains in it.
    """
    path = Path(folder) / "checkpoint.pt"
    data = [dataset.train.states, dataset.train.light_states, dataset.ground.image]
    identity = {
        "config": asdict(model.config),
        "training": asdict(config),
        "start": {"dataset": _hash_tensors(data), "weights": hash_weights(model)},
    }
    with (
        join_processes(dataset.ground.image.device) as process,
        nullcontext() if process.rank else lock_folder(folder),
    ):
        started = copy.deepcopy(model).to(process.device).train()
        started.own_place = None
        parts = _make_parts(started, config)
        log, best = _resume(path, parts, identity)
        ground = dataset.ground.to(process.device)
        alone = process.world_size == 1
        network: nn.Module = parts.model if alone else DistributedDataParallel(parts.model)
        if config.log_start and not log:
            validated = _validate(parts.model, dataset.val, ground, config)
            log.append((0.0, math.nan, math.nan, math.nan, *validated, math.nan))
            best = _copy_weights(parts.model)
        began, losses = time.perf_counter(), []
        for step in range(int(log[-1][0]) if log else 0, config.steps):
            batch = draw_batch(config, dataset.train, ground, step, process)
            top_k = compute_top_k(config, step, model.config.num_anchors)
            losses.append(
                _update(parts, network(*batch, top_k), _compute_kl_weight(config, step), step)
            )
            done = step + 1
            progress("train", done, config.steps)
            due = done % config.checkpoint_interval == 0 or done == config.steps
            if due and process.rank == 0:
                speed = len(losses) * config.batch_size / (time.perf_counter() - began)
                means = torch.tensor(losses).mean(dim=0).tolist()
                validated = _validate(parts.model, dataset.val, ground, config)
                log.append((float(done), *means, *validated, speed))
                best = _copy_weights(parts.model) if _is_best(log) else best
                _write_checkpoint(path, parts, {**identity, "best": best}, log)
                began, losses = time.perf_counter(), []
        if process.rank == 0:
            parts.model.load_state_dict(best)
        share_weights(parts.model, process)
        if process.rank == 0:
            if parts.model.config.use_observations:
                parts.model.known_views = learn_known_views(
                    parts.model, dataset.train, dataset.val, ground, step=config.history[1] - 1
                )
            with atomic_files(path.with_name("model.pt"), path.with_name("log.csv")) as written:
                write_model(parts.model, written[0])
                _write_log(log, written[1])  # again: it is missing after an unlucky interruption
    return parts.model.eval()


def learn_place(
    model: ITRA, dataset: Dataset, whole: Segments | None, *, history: int = MAX_HISTORY_STEPS
) -> ITRA:
    """Give a model a network of one place, which is trained in seconds.

    minADE in validation decides whether there is one; it then learns from all agents, also those
    that were held out, as far as is predicted. Models with trajectory proposals, of several places,
    and of segments that end with what is observed get none.

    Args:
        model: a trained model.
        dataset: training and validation segments of a place.
        whole: segments of all agents, as long as what is observed and predicted
            (`cut_beginnings`); None: there are none, and the network stays as it was validated.
        history: observed steps.

    Returns:
        The model with the network, or as it is.
    """
    train, val, ground = dataset.train, dataset.val, dataset.ground
    several = len(ground.regions) > 1 or len(train.worlds) > 1
    if model.config.num_anchors or several or train.steps <= history:
        return model
    learned = copy.deepcopy(model)
    learned.own_place = train_plain(train, model.config, history=history, place=True)
    before, after = (
        _measure_min_ade(partial(draw_covering, one), val, ground, history, 0)
        for one in (model, learned)
    )
    if after >= before:
        return model
    if whole is not None:
        learned.own_place = train_plain(whole, model.config, history=history, place=True)
    return learned


def find_best_step(log: Sequence[Mapping[str, float]]) -> int:
    """Find the step, among the rows of a log, that has the lowest minADE; the first of equal ones.

    >>> find_best_step([{"step": 0, "minADE": 0.5}, {"step": 50, "minADE": 0.6}])
    0
    """
    return int(min(log, key=lambda row: row["minADE"])["step"])


def hash_weights(model: ITRA) -> str:
    """Hash a model's weights to 12 hex digits, to tell them from others."""
    return _hash_tensors(list(model.state_dict().values()))


def _make_parts(model: ITRA, config: TrainConfig) -> _Parts:
    optimiser = torch.optim.AdamW(model.parameters(), config.learning_rate, weight_decay=0.01)
    scheduler = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, config.learning_rate, total_steps=config.steps + 1
    )
    return _Parts(model, optimiser, scheduler)


def _compute_kl_weight(config: TrainConfig, step: int) -> float:
    warmup_steps = config.kl_warmup * config.steps
    return config.kl_weight * min(1.0, (step + 1) / max(warmup_steps, 1.0))


def _sum_losses(losses: Losses, kl_weight: float) -> torch.Tensor:
    return losses.nll + losses.anchor * ANCHOR_WEIGHT + kl_weight * losses.kl


def _update(parts: _Parts, losses: Losses, kl_weight: float, step: int) -> list[float]:
    """Take a step of the optimiser; the losses as numbers."""
    loss = _sum_losses(losses, kl_weight)
    if not torch.isfinite(loss):
        raise ModelError(
            f"the loss of step {step} is {loss}: look for jumps in the tracks, or lower the "
            "learning rate"
        )
    parts.optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(parts.model.parameters(), MAX_GRADIENT_NORM)
    parts.optimiser.step()
    parts.scheduler.step()
    return [value.item() for value in (losses.nll, losses.kl, losses.anchor)]


@torch.no_grad()
def _validate(
    model: ITRA, val: Segments, ground: Ground, config: TrainConfig
) -> tuple[float, float]:
    """Compute the loss, with the final weight of its KL term, and minADE on validation segments."""
    history = config.history[1]
    segments = _pick_some(val, ground)
    error = _measure_min_ade(model.sample, val, ground, history, config.seed)
    generator = torch.Generator(ground.image.device).manual_seed(config.seed)
    loss = _sum_losses(model(segments, ground, history, generator), config.kl_weight)
    return float(loss), error


def _pick_some(val: Segments, ground: Ground) -> Segments:
    """The segments that are validated, on the ground's device."""
    stride = -(-len(val) // MAX_VAL_SEGMENTS)
    return move_to(pick(val, slice(None, None, stride)), ground.image.device)


@torch.no_grad()
def _measure_min_ade(
    predict: Predictor, val: Segments, ground: Ground, history: int, seed: int
) -> float:
    """minADE on validation segments."""
    segments = _pick_some(val, ground)
    generator = torch.Generator(ground.image.device).manual_seed(seed)
    futures = predict(segments, ground, history=history, samples=SAMPLES, generator=generator)
    errors = compute_ade(futures, segments, history).amin(dim=1)
    return float(errors[segments.controlled].mean())


def _copy_weights(model: ITRA) -> Weights:
    return {name: value.clone() for name, value in model.state_dict().items()}


def _is_best(log: list[tuple[float, ...]]) -> bool:
    """Whether the last row of a log has the lowest minADE."""
    rows = [dict(zip(LOG_COLUMNS, row, strict=True)) for row in log]
    return find_best_step(rows) == log[-1][0]


def _resume(
    path: Path, parts: _Parts, identity: dict[str, Any]
) -> tuple[list[tuple[float, ...]], Weights]:
    """Load a checkpoint, if there is one; the log until then, and the best weights."""
    if not path.exists():
        return [], {}
    state = read_state(path)
    with refuse_damaged(path, ModelError, "a checkpoint of a training"):
        differences = [
            f"{key} {state.get(name, {}).get(key)} instead of {value}"
            for name, values in identity.items()
            for key, value in values.items()
            if state.get(name, {}).get(key) != value
        ]
    if differences:
        raise ModelError(
            f"{path} is of another training ({', '.join(differences)}); name another folder"
        )
    with refuse_damaged(path, ModelError, "a checkpoint of a training"):
        best = state.get("best", state["model"])
        parts.model.load_state_dict(best)  # refuses weights that do not fit
        weights = [*best.values(), *state["model"].values()]
        for name, part in vars(parts).items():
            part.load_state_dict(state[name])
        log = [tuple(map(float, row)) for row in state["log"]]
        if "best" not in state or any(len(row) != len(LOG_COLUMNS) for row in log):
            raise ModelError(f"{path} is of another version of geoaim; name another folder")
        if not 0 <= log[-1][0] <= identity["training"]["steps"]:
            raise ModelError(f"{path} is damaged: its last step is {log[-1][0]}; delete it")
    if not all(value.isfinite().all() for value in weights):
        raise ModelError(f"{path} is damaged: a weight is not a finite number; delete it")
    return log, best


def _write_checkpoint(
    path: Path, parts: _Parts, identity: dict[str, Any], log: list[tuple[float, ...]]
) -> None:
    states = {name: part.state_dict() for name, part in vars(parts).items()}
    with atomic_files(path, path.with_name("log.csv")) as (checkpoint, table):
        write_state({**identity, **states, "log": log}, checkpoint)
        _write_log(log, table)


def _write_log(log: list[tuple[float, ...]], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(LOG_COLUMNS)
        writer.writerows([f"{value:.6g}" for value in row] for row in log)


def _hash_tensors(tensors: list[torch.Tensor]) -> str:
    digest = hashlib.sha256()
    for tensor in tensors:
        digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()[:12]
