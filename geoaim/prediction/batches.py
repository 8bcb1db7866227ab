"""Batches of a training run: which segments, how they are augmented, and what is scheduled by step.

All of it is a function of the seed and the step, so that an interrupted training resumes with the
same batches.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch
import torch.distributed as dist
from jaxtyping import Int
from torch import Tensor, nn

from geoaim.prediction.augmentation import augment
from geoaim.prediction.config import TrainConfig
from geoaim.prediction.segments import Segments, move_to, pick
from geoaim.rendering.ground import Ground


@dataclass(frozen=True)
class Process:
    """One of the processes that `torchrun` starts."""

    rank: int  # its number
    world_size: int  # how many there are
    device: torch.device  # the device that it trains on


# the first arguments of `ITRA.forward`: segments and ground, augmented; history; generator
Batch = tuple[Segments, Ground, int, torch.Generator]


@contextmanager
def join_processes(device: torch.device) -> Iterator[Process]:
    """Join the processes of `torchrun`, if any, and yield this one.

    `device` is used if there is one process or if it is a CPU; otherwise each process takes the GPU
    of its local rank.
    """
    world_size, rank = int(os.environ.get("WORLD_SIZE", 1)), int(os.environ.get("RANK", 0))
    if world_size == 1:
        yield Process(0, 1, device)
        return
    if device.type == "cuda":
        device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", 0)))
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield Process(rank, world_size, device)
        dist.barrier()  # gloo's threads abort a process that ends right after an all-reduce
    finally:
        dist.destroy_process_group()


def share_weights(model: nn.Module, process: Process) -> None:
    """Give all processes the weights of the first one."""
    if process.world_size > 1:
        for value in model.state_dict().values():
            dist.broadcast(value, 0)


def draw_batch(
    config: TrainConfig, segments: Segments, ground: Ground, step: int, process: Process
) -> Batch:
    """Draw and augment the batch of a step.

    Args:
        config: seed, sizes and augmentation.
        segments: all training segments.
        ground: their map, on the process's device.
        step: index of the training step, from 0.
        process: the process, which gets its share of the batch; augmentation is the same for all.

    Returns:
        The batch, or the process's share of it.
    """
    draws = torch.Generator().manual_seed(_derive_seed(config.seed, 2 * step))
    least, most = config.history
    history = int(torch.randint(least, most + 1, (), generator=draws))
    index = _draw_index(len(segments), config, step)[process.rank :: process.world_size]
    batch = move_to(pick(segments, index), process.device)
    batch, ground = augment(config, batch, ground, draws)
    generator = torch.Generator(process.device)
    generator.manual_seed(_derive_seed(config.seed, 2 * step + 1) + process.rank)
    return batch, ground, history, generator


def compute_top_k(config: TrainConfig, step: int, num_anchors: int) -> int:
    """Compute how many of each agent's best trajectory proposals are trained at a step.

    At first all are trained; the number falls geometrically to one, as `compute_anchor_loss`
    explains.

    Args:
        config: number of steps, and the fraction of them over which the number falls.
        step: index of the training step, from 0.
        num_anchors: proposals of each agent.

    Returns:
        A number from `num_anchors` down to 1.
    """
    annealing_steps = config.anchor_annealing * config.steps
    if step >= annealing_steps:
        return 1
    return max(1, round(num_anchors ** (1 - step / annealing_steps)))


def _draw_index(total: int, config: TrainConfig, step: int) -> Int[Tensor, "B"]:
    """Draw the segments of a step: every segment once in each epoch."""
    positions = torch.arange(step * config.batch_size, (step + 1) * config.batch_size)
    order = {
        epoch: torch.randperm(
            total, generator=torch.Generator().manual_seed(_derive_seed(config.seed, -1 - epoch))
        )
        for epoch in sorted(set((positions // total).tolist()))
    }
    return torch.stack([order[k // total][k % total] for k in positions.tolist()])


def _derive_seed(seed: int, number: int) -> int:
    """Derive a seed, far apart for numbers that are near: 64 bits of a Weyl sequence."""
    return ((seed + 1) * 0x9E3779B97F4A7C15 + number * 0xD1B54A32D192ED03) % 2**63
