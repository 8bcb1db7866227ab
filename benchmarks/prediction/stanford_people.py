"""Windows of Stanford's people joined to whole ways, with the others around at the same time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray as Array
from torch import Tensor

from benchmarks.prediction.windows import (
    HISTORY_STEPS,
    WINDOW_STEPS,
    read_resolutions,
    read_trajnet_windows,
)
from geoaim.tracks.files import read_table

JOIN_M = 0.4  # 70 % of the training windows go on in another that starts so near
FRAMES_PER_STEP = 12
OTHERS = 6  # the nearest


@dataclass(frozen=True, eq=False)
class Way:
    """One person's way through a scene: joined windows."""

    frames: Int[Array, "t"]
    positions: Float[Array, "t 2"]  # metres


@dataclass(frozen=True, eq=False)
class People:
    """Windows, and the others who are there at their last observed step."""

    paths: Float[Tensor, "B T 2"]  # metres
    # of the nearest others, offset from the person and last displacement, metres; NaN: none
    others: Float[Tensor, "B K 4"]
    resolutions: Float[Tensor, "B"]  # metres per pixel
    scenes: tuple[str, ...]  # the scene of each window


def read_people(folder: Path, scenes: Sequence[str], *, training: bool) -> People:
    """Read the windows of some scenes, and find the others around.

    Args:
        folder: holds `windows/<scene>.csv` and `scenes.csv`, see `benchmarks.prediction.windows`.
        scenes: names of the scenes.
        training: whether to cut a window at each step of the joined ways, forwards and backwards,
            instead of the windows of the files.
    """
    scales = read_resolutions(folder / "scenes.csv")
    parts = []
    for name in scenes:
        path = folder / "windows" / f"{name}.csv"
        paths = read_trajnet_windows(path, scales[name])
        numbers = read_table(path, text=("track",))["frame"].to_numpy(int)
        frames = numbers.reshape(-1, WINDOW_STEPS)
        ways = join_windows(frames, paths)
        cuts = [(frames, paths, ways)]
        if training:
            cuts = [(*cut_windows(some), some) for some in (ways, reverse_ways(ways))]
        parts += [_find_people(*cut, name, scales[name]) for cut in cuts]
    return People(
        torch.cat([part.paths for part in parts]),
        torch.cat([part.others for part in parts]),
        torch.cat([part.resolutions for part in parts]),
        tuple(name for part in parts for name in part.scenes),
    )


def join_windows(frames: Int[Array, "B T"], paths: Float[Array, "B T 2"]) -> list[Way]:
    """Join windows of one person: the next starts where the last one leads, a step later.

    Args:
        frames: frames of each window.
        paths: positions, metres.

    Returns:
        The ways, each with one window or more.

    >>> steps = np.arange(40.0)
    >>> path = np.stack([steps, 0 * steps], axis=1).reshape(2, 20, 2)
    >>> [way.positions.shape for way in join_windows(12 * steps.astype(int).reshape(2, 20), path)]
    [(40, 2)]
    """
    pairs = []
    for first in range(len(paths)):
        later = np.flatnonzero(frames[:, 0] - frames[first, -1] == FRAMES_PER_STEP)
        onwards = 2 * paths[first, -1] - paths[first, -2] - paths[later, 0]
        backwards = 2 * paths[later, 0] - paths[later, 1] - paths[first, -1]
        gaps = np.maximum(*(np.linalg.norm(gap, axis=1) for gap in (onwards, backwards)))
        pairs += [(gap, first, second) for gap, second in zip(gaps, later, strict=True)]
    after: dict[int, int] = {}
    for gap, first, second in sorted(pairs):
        if gap < JOIN_M and first not in after and second not in after.values():
            after[first] = int(second)
    ways = []
    for start in sorted(set(range(len(paths))) - set(after.values())):
        rows = [start]
        while rows[-1] in after:
            rows.append(after[rows[-1]])
        ways.append(Way(np.concatenate(frames[rows]), np.concatenate(paths[rows])))
    return ways


def reverse_ways(ways: Sequence[Way]) -> list[Way]:
    """Reverse ways in time, as an augmentation."""
    return [Way(-way.frames[::-1], way.positions[::-1]) for way in ways]


def cut_windows(ways: Sequence[Way]) -> tuple[Int[Array, "B T"], Float[Array, "B T 2"]]:
    """Cut a window at each step of each way: frames and positions."""
    starts = [(way, i) for way in ways for i in range(len(way.frames) - WINDOW_STEPS + 1)]
    frames = np.array([way.frames[i : i + WINDOW_STEPS] for way, i in starts])
    return frames, np.array([way.positions[i : i + WINDOW_STEPS] for way, i in starts])


def find_others(
    frames: Int[Array, "B"], positions: Float[Array, "B 2"], ways: Sequence[Way]
) -> Float[Array, "B K 4"]:
    """Find the nearest others at some frames, by what is known then.

    Args:
        frames: a frame of each person.
        positions: where the person is then, metres.
        ways: those of all people, which include the person's own.

    Returns:
        Offsets from the person and displacements since the step before (0 where the way begins).
    """
    moves = [np.diff(way.positions, axis=0, prepend=way.positions[:1]) for way in ways]
    known = [np.hstack([way.positions, move]) for way, move in zip(ways, moves, strict=True)]
    times, table = np.concatenate([way.frames for way in ways]), np.concatenate(known)
    order = np.argsort(times, kind="stable")
    times, table = times[order], table[order]
    first, last = (np.searchsorted(times, frames, side) for side in ("left", "right"))
    others = np.full((len(frames), OTHERS, 4), np.nan)
    for row, (start, end) in enumerate(zip(first, last, strict=True)):
        there = table[start:end] - [*positions[row], 0, 0]
        distances = np.hypot(there[:, 0], there[:, 1])
        nearest = np.argsort(distances)
        nearest = nearest[distances[nearest] > 0][:OTHERS]  # at 0 is the person
        others[row, : len(nearest)] = there[nearest]
    return others


def _find_people(
    frames: Int[Array, "B T"],
    paths: Float[Array, "B T 2"],
    ways: Sequence[Way],
    scene: str,
    resolution: float,
) -> People:
    now = HISTORY_STEPS - 1
    others = find_others(frames[:, now], paths[:, now], ways)
    return People(
        torch.tensor(paths).float(),
        torch.tensor(others).float(),
        torch.full((len(paths),), resolution),
        (scene,) * len(paths),
    )


def select_people(people: People, rows: Int[Tensor, "b"]) -> People:
    """Select some windows; names of scenes stay away."""
    return replace(
        people,
        paths=people.paths[rows],
        others=people.others[rows],
        resolutions=people.resolutions[rows],
        scenes=(),
    )
