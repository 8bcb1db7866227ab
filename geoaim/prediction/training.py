"""Training: a plain loop that can be killed at any time and goes on where it was."""

import csv
import hashlib
import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from jaxtyping import Int
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from geoaim.errors import ModelError
from geoaim.files import atomic_write
from geoaim.prediction.atlas import ground_scaled
from geoaim.prediction.checkpoints import read_state, write_model, write_state
from geoaim.prediction.itra import ITRA, Config, Losses
from geoaim.prediction.lessons import Lessons
from geoaim.prediction.metrics import displacements
from geoaim.prediction.segments import Segments, pick, scaled, segments_on
from geoaim.progress import Progress, no_progress
from geoaim.simulation.ground import Ground, on_device

CHECKED = 256  # segments at most that are predicted for the log
SAMPLES = 6
PLAN = 12.0  # weight of metres from the best plans; the fit is in sigmas, squared
CLIP = 1.0  # of the gradient's norm
NARROWING = 0.8  # share of the steps over which fewer and fewer plans learn from each segment
LOG = ("step", "fit", "divergence", "plan", "minADE", "segments a second")


@dataclass(frozen=True)
class Training:
    """How a model is trained.

    Attributes:
        steps: of the optimiser.
        batch: segments of each, of all processes together.
        rate: the highest learning rate, of one cycle (Smith 2018).
        divergence: weight of the latents' divergence in the end. 1 is the evidence lower bound;
            with more, latents tell less of what was done, and the model looks at map, lights and
            others to know it.
        warm_up: share of the steps in which that weight rises from zero, so that latents come to
            be used at all (Bowman et al. 2016).
        observed: fewest and most steps that are given, drawn for each batch.
        mirror: whether half of the batches are mirrored; not where people keep to one side.
        resize: share by which batches are made larger or smaller at most.
        colour: share by which a batch's ground is brighter or darker at most, in each channel.
        seed: of everything random.
        save: steps from one checkpoint to the next.
    """

    steps: int
    batch: int = 64
    rate: float = 2e-3
    divergence: float = 3.0
    warm_up: float = 0.3
    observed: tuple[int, int] = (1, 10)
    mirror: bool = False
    resize: float = 0.0
    colour: float = 0.0
    seed: int = 0
    save: int = 250


def from_scratch(kind: str, *, steps: int, batch: int, seed: int = 0) -> Training:
    """The training of a new model."""
    mirror = kind == "pedestrian"  # people keep to no side
    return Training(steps, batch, mirror=mirror, seed=seed)


def fine_tuning(kind: str, *, steps: int, batch: int, seed: int = 0) -> Training:
    """The training of a model that is good already: gentle, with its latents in use throughout."""
    training = from_scratch(kind, steps=steps, batch=batch, seed=seed)
    return replace(training, rate=5e-4, warm_up=0.0, save=50)


def train(
    config: Config,
    training: Training,
    lessons: Lessons,
    folder: str | os.PathLike[str],
    *,
    start: ITRA | None = None,
    progress: Progress = no_progress,
) -> ITRA:
    """Train a model, on the ground's device, or go on with the training that is in the folder.

    Writes `checkpoint.pt`, `log.csv` and, at the end, `model.pt`. On a CPU, with as many threads,
    the same seed gives the same weights, interrupted or not. Under `torchrun` processes share each
    batch.

    Args:
        config: what the model is made of.
        training: how it is trained.
        lessons: what from.
        folder: where its files lie.
        start: a model to begin with, whose config it has; None: from scratch.
        progress: takes stage, done and total.

    Raises:
        ValueError: the folder holds another training.
        ModelError: its checkpoint cannot be read, or the loss is not finite.
    """
    path = Path(folder) / "checkpoint.pt"
    with _processes(lessons.ground.image.device) as (rank, count, device):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(training.seed)
            model = ITRA(config).to(device)
        if start is not None:
            model.load_state_dict(start.state_dict())
        optimiser = torch.optim.AdamW(model.parameters(), training.rate, weight_decay=0.01)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, training.rate, total_steps=training.steps + 1
        )
        kept: dict[str, Any] = {"model": model, "optimiser": optimiser, "schedule": schedule}
        about = {
            "config": asdict(config),
            "training": asdict(training),
            "start": {"lessons": digest(lessons), "weights": digest(start)},
        }
        log = _resume(path, kept, about)
        network: nn.Module = model if count == 1 else DistributedDataParallel(model)
        ground, began, sums = on_device(lessons.ground, device), time.perf_counter(), []
        if start is not None and not log:
            before = _check(model, lessons.valid, ground, training)
            log.append((0, math.nan, math.nan, math.nan, before, math.nan))
        for step in range(int(log[-1][0]) if log else 0, training.steps):
            winners = _winners(training, step, config.modes) if start is None else 1
            losses = _losses(network, training, lessons.train, ground, step, winners, (rank, count))
            loss = losses.fit + losses.plan * PLAN + _weight(training, step) * losses.divergence
            if not torch.isfinite(loss):
                raise ModelError(
                    f"the loss of step {step} is {loss}: look for jumps in the tracks, or "
                    "lower the rate of learning"
                )
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(model.parameters(), CLIP)
            optimiser.step()
            schedule.step()
            sums.append([x.item() for x in (losses.fit, losses.divergence, losses.plan)])
            progress("train", step + 1, training.steps)
            done = step + 1
            if rank == 0 and (done % training.save == 0 or done == training.steps):
                speed = len(sums) * training.batch / (time.perf_counter() - began)
                means = torch.tensor(sums).mean(dim=0).tolist()
                log.append((done, *means, _check(model, lessons.valid, ground, training), speed))
                state = {name: part.state_dict() for name, part in kept.items()}
                write_state({**about, **state, "log": log}, path)
                _write_log(log, path.with_name("log.csv"))
                began, sums = time.perf_counter(), []
        if rank == 0:
            write_model(model, path.with_name("model.pt"))
    return model.eval()


def _resume(path: Path, kept: dict[str, Any], about: dict[str, Any]) -> list[tuple[float, ...]]:
    """Load a checkpoint into what is kept; the log until then."""
    if not path.exists():
        return []
    state = read_state(path)
    found: dict[str, Any] = {name: state.get(name, {}) for name in about}
    if found != about:
        odd = [
            f"{key} {found[name].get(key)} instead of {value}"
            for name, values in about.items()
            for key, value in values.items()
            if found[name].get(key) != value
        ]
        raise ValueError(f"{path} is of another training ({', '.join(odd)}); name another folder")
    for name, part in kept.items():
        part.load_state_dict(state[name])
    return [tuple(row) for row in state["log"]]


def digest(what: Lessons | ITRA | None) -> str:
    """Tells one set of lessons, or of weights to begin with, from another."""
    if what is None:
        return "none"
    tensors = (
        list(what.state_dict().values())
        if isinstance(what, ITRA)
        else [what.train.states, what.train.lights, what.ground.image]
    )
    found = hashlib.sha256()
    for tensor in tensors:
        found.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return found.hexdigest()[:12]


def _losses(
    network: nn.Module,
    training: Training,
    segments: Segments,
    ground: Ground,
    step: int,
    winners: int,
    share: tuple[int, int],
) -> Losses:
    """Of one step's batch, or this process's share of it; the same at each run."""
    rank, count = share
    draw = torch.Generator().manual_seed(_seed(training.seed, 2 * step))
    few, most = training.observed
    observed = int(torch.randint(few, most + 1, (), generator=draw))
    size, side = torch.rand(2, generator=draw)
    sides = (1 + training.resize * (2 * size - 1)).repeat(2)
    if training.mirror and side > 0.5:
        sides = sides * sides.new_tensor([1.0, -1.0])
    if training.colour:
        gain = 1 + training.colour * (2 * torch.rand(3, 1, 1, generator=draw) - 1)
        shift = training.colour * (torch.rand(3, 1, 1, generator=draw) - 0.5)
        image = ground.image * gain.to(ground.image) + shift.to(ground.image)
        ground = replace(ground, image=image)
    batch = _numbers(len(segments), training, step)[rank::count]
    some = scaled(segments_on(pick(segments, batch), ground.image.device), sides)
    noise = torch.Generator(ground.image.device)
    noise.manual_seed(_seed(training.seed, 2 * step + 1) + rank)
    return network(some, ground_scaled(ground, sides), observed, noise, winners)


def _numbers(total: int, training: Training, step: int) -> Int[Tensor, "B"]:
    """Which segments a step's batch is: each once before any comes again."""
    at = torch.arange(step * training.batch, (step + 1) * training.batch)
    order = {
        epoch: torch.randperm(
            total, generator=torch.Generator().manual_seed(_seed(training.seed, -1 - epoch))
        )
        for epoch in sorted(set((at // total).tolist()))
    }
    return torch.stack([order[k // total][k % total] for k in at.tolist()])


def _seed(seed: int, number: int) -> int:
    """Far apart for numbers that are near: 64 bits of a Weyl sequence."""
    return ((seed + 1) * 0x9E3779B97F4A7C15 + number * 0xD1B54A32D192ED03) % 2**63


def _weight(training: Training, step: int) -> float:
    rising = training.warm_up * training.steps
    return training.divergence * min(1.0, (step + 1) / max(rising, 1.0))


def _winners(training: Training, step: int, modes: int) -> int:
    """From all plans to one; see `plan_loss`."""
    left = 1 - step / (NARROWING * training.steps)
    return max(1, round(modes ** max(0.0, left)))


def _check(model: ITRA, valid: Segments, ground: Ground, training: Training) -> float:
    """minADE of some segments that are not learnt from."""
    every = -(-len(valid) // CHECKED)
    some = segments_on(pick(valid, slice(None, None, every)), ground.image.device)
    generator = torch.Generator(ground.image.device).manual_seed(training.seed)
    observed = training.observed[1]
    found = model.sample(some, ground, observed=observed, samples=SAMPLES, generator=generator)
    return float(displacements(found, some, observed).amin(dim=1)[some.controlled].mean())


def _write_log(log: list[tuple[float, ...]], path: Path) -> None:
    with atomic_write(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(LOG)
        writer.writerows([f"{value:.6g}" for value in row] for row in log)


@contextmanager
def _processes(device: torch.device) -> Iterator[tuple[int, int, torch.device]]:
    """This process's number, how many there are, and its device."""
    count, rank = int(os.environ.get("WORLD_SIZE", 1)), int(os.environ.get("RANK", 0))
    if count == 1:
        yield 0, 1, device
        return
    if device.type == "cuda":
        device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", 0)))
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield rank, count, device
    finally:
        dist.destroy_process_group()
