"""Clips of a disturbance, with the true place on the ground of each frame's pixels."""

import itertools
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import cast, get_args

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from benchmarks.data import find_data, require_data
from benchmarks.registration.stability.effects import Image, apply_effects
from benchmarks.registration.stability.kinds import KINDS, Disturbance
from benchmarks.registration.stability.motion import CameraMotion, draw_motion
from benchmarks.registration.stability.splines import SplineScene
from benchmarks.registration.stability.warped import WarpedScene
from benchmarks.synthetic import draw_place, make_place
from benchmarks.synthetic.roads.layouts import PlaceKind

FRAMES = 11
SMALL, LARGE = (540, 960), (1080, 1920)  # height and width of the frames, px
LARGE_SHARE = 8  # clips for each large one
STILL_WIDTH = 3840  # px
# Bases of each split: the generator, what it shows, and whether that is real data.
BASES: dict[str, tuple[tuple[str, str, bool], ...]] = {
    "validation": (
        ("warped", "hover/songdo_stills/00003.jpg", True),
        ("warped", "junction", False),
        ("splines", "town", False),
    ),
    "test": (
        ("warped", "hover/songdo_stills/00972.jpg", True),
        ("warped", "roundabout", False),
        ("splines", "fields", False),
    ),
}
TEST_STEP = 0.3  # how far levels of the test split lie towards the next level


SyntheticScene = WarpedScene | SplineScene


@dataclass(frozen=True)
class SweepCase:
    """One clip of the sweep."""

    kind: str  # kind of disturbance
    rank: int  # number of the level
    level: float  # level in the kind's unit
    generator: str  # "warped" or "splines"
    base: str  # what the ground is
    size: tuple[int, int]  # height and width of the frames, px
    seed: int  # random seed


@dataclass(frozen=True)
class Clip:
    """Frames, and where their pixels lie on the ground."""

    frames: list[Image]  # grey or RGB
    shown: list[int]  # index, in the scene, of each frame
    scene: SyntheticScene  # source of the true frame positions
    size: tuple[int, int]  # height and width of the frames, px

    def find_truth(self, reference: int, index: int) -> Float[Array, "25 2"]:
        """Compute where (u, v) the reference shows the ground of a frame's `make_check_points`."""
        ground = self.scene.ground_from_frame(self.shown[index], make_check_points(self.size))
        return _invert(self.scene, self.shown[reference], ground, self.size)


def make_check_points(size: tuple[int, int]) -> Float[Array, "25 2"]:
    """Make 5 x 5 points (u, v) from corner to corner of a frame (height, width), row by row."""
    x, y = np.meshgrid(np.linspace(0, size[1], 5), np.linspace(0, size[0], 5))
    return np.stack([x, y], axis=-1).reshape(-1, 2)


def _invert(
    scene: SyntheticScene, index: int, ground: Float[Array, "n 2"], size: tuple[int, int]
) -> Float[Array, "n 2"]:
    """Find the pixels of a frame that show points of the ground, by Newton's method."""
    grid = make_check_points(size)
    known = scene.ground_from_frame(index, grid)
    matrix, _ = cv2.findHomography(known, grid)  # exact but for lens and rolling shutter
    pixels = cv2.perspectiveTransform(ground[None], matrix)[0]
    for _ in range(30):
        error = ground - scene.ground_from_frame(index, pixels)
        moved = cv2.perspectiveTransform((ground - error)[None], matrix)[0]
        step = cv2.perspectiveTransform(ground[None], matrix)[0] - moved
        pixels = pixels + step
        if np.abs(step).max() < 1e-9:
            break
    return pixels


def list_cases(
    split: str, kinds: Sequence[str], *, repeats: int = 1, skipped: int = 0
) -> Iterator[SweepCase]:
    """List the clips of a sweep: every level of each kind on every base that can be had.

    Args:
        split: "validation" or "test".
        kinds: names of kinds.
        repeats: seeds for each level and base.
        skipped: seeds to leave out, since earlier sweeps used them.

    Yields:
        The cases.
    """
    bases = [base for base in BASES[split] if find_data() is not None or not base[2]]
    seeds = range(skipped, skipped + repeats)
    for name in kinds:
        levels = KINDS[name].levels
        for rank, level in enumerate(levels):
            following = levels[min(rank + 1, len(levels) - 1)]
            level += (following - level) * (TEST_STEP if split == "test" else 0)
            for number, repeat in itertools.product(range(len(bases)), seeds):
                generator, base, _ = bases[number]
                key = f"{split} {name} {rank} {base} {repeat}"
                seed = zlib.crc32(key.encode())
                size = LARGE if seed % LARGE_SHARE == 0 else SMALL
                yield SweepCase(name, rank, level, generator, base, size, seed)


def make_clip(case: SweepCase, count: int = FRAMES) -> Clip:
    """Render `count` frames of a case."""
    disturbance = KINDS[case.kind].make(case.level)
    generator = np.random.default_rng(case.seed)
    dropped = any(name == "drop" for name, _ in disturbance.effects)
    motion = draw_motion(disturbance, count + dropped * count, case.size[1], generator)
    scene = _make_scene(case, disturbance, motion, generator)
    images = [scene.render(index) for index in range(len(motion.angle))]
    frames, shown = apply_effects(images, disturbance.effects, case.seed)
    return Clip(frames, shown, scene, case.size)


def _make_scene(
    case: SweepCase, disturbance: Disturbance, motion: CameraMotion, generator: np.random.Generator
) -> SyntheticScene:
    if case.generator == "splines":
        return SplineScene(case.base, disturbance, motion, case.size, generator)
    return WarpedScene(_read_still(case.base), disturbance, motion, case.size, generator)


@cache
def _read_still(base: str) -> UInt8[Array, "_ _"]:
    """Read a real still, or draw a place; grey, of the same width."""
    if base in get_args(PlaceKind):
        place = make_place(3, kind=cast(PlaceKind, base))
        image = np.asarray(cv2.cvtColor(draw_place(place), cv2.COLOR_RGB2GRAY), np.uint8)
    else:
        path = require_data() / base
        image = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), np.uint8)
    height = round(image.shape[0] * STILL_WIDTH / image.shape[1])
    resized = cv2.resize(image, (STILL_WIDTH, height), interpolation=cv2.INTER_CUBIC)
    return np.asarray(resized, np.uint8)
