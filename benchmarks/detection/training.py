"""Training of the detector: drawn pictures without end, and perhaps stills."""

import importlib.util
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from benchmarks.detection.examples import (
    LENGTH,
    WIDTH,
    degrade,
    flip_and_turn,
    make_target,
    make_upright_target,
)
from benchmarks.detection.exporting import export_network, fit_calibration, write_calibration
from benchmarks.detection.judging import join, judge_stills
from benchmarks.detection.network import Network
from benchmarks.detection.scenes import draw_scene
from benchmarks.detection.stills import (
    TRAINING,
    Still,
    draw_stills,
    read_palace,
    read_roofs,
    read_stills,
    split,
)
from geoaim.base.errors import GeoaimError
from geoaim.detection.network import RESOLUTION, read_calibration

PIXELS = 224  # side of an example
BATCH = 6
POOL = 600  # drawn scenes that are kept; each is shown about three times
Example = tuple[np.ndarray, ...]


class Scenes:
    """Scenes that are drawn while the network learns, each of which is shown a few times."""

    def __init__(self, generator: np.random.Generator, stage: "Stage") -> None:
        self.generator, self.stage = generator, stage
        self.pool: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def take(self, number: int) -> list[Example]:
        """Take examples, one of them newly drawn."""
        g = self.generator
        # a video's scale is known to a tenth: cars are drawn larger or smaller than they are
        resolution = self.stage.resolution
        drawn = draw_scene(PIXELS, resolution * np.exp(g.normal(0, self.stage.scatter)), g)
        self.pool.append(drawn)
        if len(self.pool) > POOL:
            self.pool.pop(0)
        picks = [len(self.pool) - 1, *g.integers(len(self.pool), size=number - 1).tolist()]
        examples: list[Example] = []
        for k in picks:
            image, boxes, hidden = self.pool[k]
            image, boxes = flip_and_turn(image, boxes, g)
            target = make_target(boxes, hidden, PIXELS, resolution)
            examples.append((degrade(image, g), *target, np.array(False)))
        return examples


class Stills:
    """Crops of labelled stills, whose boxes are upright: they tell the middle and the extent."""

    def __init__(
        self, places: list[list[Still]], generator: np.random.Generator, stage: "Stage"
    ) -> None:
        self.generator, self.places, self.stage = generator, places, stage

    def take(self, number: int) -> list[Example]:
        """Take examples, of each place as often: around a vehicle, or anywhere."""
        examples: list[Example] = []
        for _ in range(number):
            place = self.places[self.generator.integers(len(self.places))]
            examples.append(self._cut(place[self.generator.integers(len(place))]))
        return examples

    def _cut(self, still: Still) -> Example:
        g, side = self.generator, PIXELS
        resolution = self.stage.resolution
        factor = still.resolution / resolution * np.exp(g.normal(0, self.stage.scatter))
        height, width = still.image.shape[:2]
        middle = g.uniform(0, 1, 2) * [width, height]
        labelled = np.flatnonzero(~still.ignored)
        if len(labelled) and g.uniform() < 0.8:
            left, top, right, bottom = still.boxes[g.choice(labelled)]
            middle = np.array([left + right, top + bottom]) / 2
            middle = middle + g.uniform(-0.4, 0.4, 2) * side / factor
        quarter, mirror = g.integers(4) * np.pi / 2, g.choice([-1, 1])
        c, s = np.round([np.cos(quarter), np.sin(quarter)])
        turn = np.array([[c, -s], [s, c]]) @ np.diag([mirror, 1.0])
        # reduced by area first: a warp alone would leave out pixels
        area = still.image[_window(middle, 0.75 * side / factor, height, width)]
        origin = np.maximum(np.floor(middle - 0.75 * side / factor), 0)
        how = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
        size = np.maximum(np.round(np.array(area.shape[1::-1]) * factor), 1).astype(int)
        small = cv2.resize(area, tuple(size.tolist()), interpolation=how)
        small_middle = (middle - origin) * factor
        matrix = np.c_[turn, side / 2 - turn @ small_middle]
        shifted = matrix.copy()
        shifted[:, 2] += turn @ [0.5, 0.5] - 0.5
        image = cv2.warpAffine(small, shifted, (side, side), borderMode=cv2.BORDER_REFLECT)
        known = cv2.warpAffine(np.full(small.shape[:2], 255, np.uint8), shifted, (side, side)) > 250
        corners = (still.boxes.reshape(-1, 2, 2) - origin) * factor @ turn.T + matrix[:, 2]
        ends = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
        parts = make_upright_target(ends, still.ignored, known, resolution)
        return degrade(image, g), *parts, np.array(True)


def _window(middle: np.ndarray, reach: float, height: int, width: int) -> tuple[slice, slice]:
    low = np.maximum(np.floor(middle - reach), 0).astype(int)
    high = np.minimum(np.ceil(middle + reach), [width, height]).astype(int)
    return slice(low[1], max(high[1], low[1] + 1)), slice(low[0], max(high[0], low[0] + 1))


def compute_loss(
    output: Tensor, target: Tensor, near: Tensor, weight: Tensor, upright: Tensor
) -> Tensor:
    """Compute the focal loss of the heat and the error of the geometry."""
    heat, probability = output[:, 0], output[:, 0].sigmoid()
    middle = (target[:, 0] > 0.99) * weight
    found = -((1 - probability) ** 2) * F.logsigmoid(heat) * middle
    other = (1 - target[:, 0]) ** 4 * weight * (target[:, 0] <= 0.99)
    false = -other * probability**2 * F.logsigmoid(-heat)
    scale = torch.tensor([1.0, 1, 2, 2, 1, 1, 0.5, 0.5])[:, None, None]
    error = F.smooth_l1_loss(output[:, 1:], target[:, 1:], reduction="none", beta=0.3) * scale
    extent = F.smooth_l1_loss(_get_extent(output), target[:, 3:5], reduction="none", beta=0.3)
    offset = error[:, :2].sum(1)
    error = torch.where(upright[:, None, None], offset + extent.sum(1), error.sum(1))
    near = near * weight
    geometry = (error * near).sum() / near.sum().clamp(min=1)
    return (found.sum() + false.sum()) / middle.sum().clamp(min=1) + 0.5 * geometry


def _get_extent(output: Tensor) -> Tensor:
    """Get the logarithms of the width and height (m) of the bounds of oriented boxes."""
    length, width = LENGTH * output[:, 3].exp(), WIDTH * output[:, 4].exp()
    double = output[:, 5] / output[:, 5:7].square().sum(1).add(1e-4).sqrt()
    c, s = ((1 + double) / 2 + 1e-4).sqrt(), ((1 - double) / 2 + 1e-4).sqrt()
    return torch.stack([length * c + width * s, length * s + width * c], dim=1).log()


@dataclass(frozen=True)
class Stage:
    """A stage of the training."""

    steps: int
    learning_rate: float  # the highest
    stills: int  # of the examples of a batch
    scatter: float  # standard deviation of the logarithm of how large vehicles are shown
    resolution: float  # metres per pixel


DRAWN = Stage(4500, 4e-3, 0, 0.1, 0.28)
WITH_STILLS = Stage(1200, 1.5e-3, 3, 0.1, 0.28)
OTHER_SIZES = Stage(1500, 1.5e-3, 3, 0.15, 0.28)
FINER = Stage(800, 1e-3, 3, 0.1, RESOLUTION)
AVERAGED = 2  # trainings of the last stage


def train(
    network: Network, stage: Stage, path: Path, *, stills: list[list[Still]], seed: int = 0
) -> None:
    """Train a network for a stage, and write its weights."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    generator = np.random.default_rng(seed)
    scenes, crops = Scenes(generator, stage), Stills(stills, generator, stage)
    network.to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, stage.learning_rate, stage.steps, pct_start=0.15
    )
    start, mean = time.process_time(), 0.0
    for step in range(stage.steps):
        examples = scenes.take(BATCH - stage.stills) + crops.take(stage.stills)
        image, *truth = (torch.from_numpy(np.stack(part)) for part in zip(*examples, strict=True))
        with torch.autocast("cpu", torch.bfloat16):  # half the time, where the processor has it
            output = network(image.contiguous(memory_format=torch.channels_last))
        loss = compute_loss(output.float(), *truth)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(network.parameters(), 5)
        optimizer.step()
        schedule.step()
        mean = 0.98 * mean + 0.02 * loss.item() if step else loss.item()
        if step % 100 == 99:
            print(f"{step + 1} {mean:.3f} {time.process_time() - start:.0f} s", flush=True)
        if step % 500 == 499:
            torch.save(network.state_dict(), path)
    torch.save(network.state_dict(), path)


def train_all(folder: Path, seed: int = 0) -> None:
    """Train on drawings alone, then with stills; write drawn.onnx and vehicles.onnx to a folder.

    The weights that are shipped are the mean of those with stills and of several that went on from
    there, which is better than any of them on the stills of validation.

    Raises:
        GeoaimError: the package `onnx` is missing, which the files need.
    """
    if importlib.util.find_spec("onnx") is None:
        raise GeoaimError("the package onnx, which writes the network, is missing: install it")
    folder.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(seed)
    network = Network()
    places = [list(read_stills(kind)) for kind in TRAINING]
    halves = [[split(still) for still in place] for place in places]
    stills = [[first for first, _ in place] for place in halves] + [read_roofs()]
    validation = [*([second for _, second in place] for place in halves), list(draw_stills(60))]
    train(network, DRAWN, folder / "drawn.pt", stills=stills, seed=seed)
    finish(network, validation, folder / "drawn.onnx", RESOLUTION / DRAWN.resolution)
    train(network, WITH_STILLS, folder / "stills.pt", stills=stills, seed=seed)
    parts, stills = [folder / "stills.pt"], [*stills, [read_palace()]]
    train(network, OTHER_SIZES, folder / "sizes.pt", stills=stills, seed=seed + 1)
    for number in range(AVERAGED):
        network.load_state_dict(torch.load(folder / "sizes.pt"))
        parts.append(folder / f"finer{number}.pt")
        train(network, FINER, parts[-1], stills=stills, seed=seed + 2 + number)
    network.load_state_dict(average_weights([torch.load(part) for part in parts]))
    finish(network, validation, folder / "vehicles.onnx")


def average_weights(parts: list[dict[str, Tensor]]) -> dict[str, Tensor]:
    """Average the weights of networks that began as one.

    >>> average_weights([{"a": torch.ones(1)}, {"a": torch.zeros(1)}])["a"].item()
    0.5
    """
    return {
        name: (sum((part[name].float() for part in parts), torch.zeros(())) / len(parts)).to(
            value.dtype
        )
        for name, value in parts[0].items()
    }


def finish(network: Network, validation: list[list[Still]], path: Path, scale: float = 1.0) -> None:
    """Export a network, with probabilities that are calibrated on places of validation.

    Each place counts alike: most labels are of one place, where little else looks like a vehicle.
    """
    export_network(network, path)
    write_calibration({"slope": 1.0, "offset": 0.0}, path.with_suffix(".json"))
    judged = [judge_stills(stills, path, scale=scale) for stills in validation]
    weights = np.concatenate([np.full(len(j.logits), 1 / len(j.logits)) for j in judged])
    found = join(judged)
    line = fit_calibration(found.logits, found.right, weights)
    write_calibration(line, path.with_suffix(".json"))
    read_calibration.cache_clear()
