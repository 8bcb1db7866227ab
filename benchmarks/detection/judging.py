"""Judging: what was found against labelled boxes."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from benchmarks.detection.stills import BORDER, Still
from geoaim.detection.network import MODEL, Peaks, find_peaks, read_calibration
from geoaim.detection.vehicles import resample

NEAR = 0.35  # of a box's width and height: how far off a middle may lie
SMALLEST = 2.0  # metres that a box's sides count at least
LOWEST = -4.0  # log odds below which nothing is judged


@dataclass(frozen=True, eq=False)
class Judged:
    """What was found on stills: how probable it was, and whether it is right."""

    logits: Float[Array, " N"]
    probabilities: Float[Array, " N"]
    right: Bool[Array, " N"]
    overlaps: Float[Array, " N"]  # of upright bounds over their union; NaN for what is wrong
    labelled: int

    def get_rates(self, probability: float) -> tuple[float, float]:
        """Get recall and precision of what is at least so probable."""
        chosen = self.probabilities >= probability
        hits = int(self.right[chosen].sum())
        return hits / max(self.labelled, 1), hits / max(int(chosen.sum()), 1)


def judge_stills(stills: Iterable[Still], model: Path = MODEL, *, scale: float = 1.0) -> Judged:
    """Judge a network on stills, of whose scale it may be told a multiple."""
    slope, offset = read_calibration(model)
    return join([judge(s, detect_on(s, model, scale), slope, offset) for s in stills])


def join(parts: list[Judged]) -> Judged:
    """Join what was judged on several stills."""
    names = "logits", "probabilities", "right", "overlaps"
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return Judged(**arrays, labelled=sum(part.labelled for part in parts))


def detect_on(still: Still, model: Path = MODEL, scale: float = 1.0) -> Peaks:
    """Detect vehicles on a still; in its own pixels."""
    small = resample(still.image, still.resolution * scale)
    peaks = find_peaks(small, LOWEST, model)
    factor = still.image.shape[1] / small.shape[1]
    return Peaks(
        peaks.centres * factor,
        peaks.headings,
        peaks.lengths * factor,
        peaks.widths * factor,
        peaks.logits,
    )


def judge(still: Still, peaks: Peaks, slope: float = 1.0, offset: float = 0.0) -> Judged:
    """Match what was found with the labels of a still, the most probable first."""
    height, width = still.image.shape[:2]
    rim = BORDER / still.resolution
    centres = peaks.centres
    inner = (centres > rim) & (centres < np.array([width, height]) - rim)
    counted = np.asarray(inner.all(axis=1))
    middles = (still.boxes[:, :2] + still.boxes[:, 2:]) / 2
    sides = np.maximum(still.boxes[:, 2:] - still.boxes[:, :2], SMALLEST / still.resolution)
    corners = peaks.get_corners()
    bounds = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
    right, overlaps = np.zeros(len(centres), bool), np.full(len(centres), np.nan)
    free = np.ones(len(middles), bool)
    for k in np.argsort(-peaks.logits, kind="stable"):
        far = (np.abs(centres[k] - middles) / sides).max(axis=1, initial=0)
        near = np.flatnonzero(free & (far < NEAR)) if len(middles) else np.empty(0, int)
        if len(near):
            best = near[np.argmin(far[near])]
            free[best] = False
            right[k], overlaps[k] = True, _overlap(bounds[k], still.boxes[best])
            counted[k] &= not still.ignored[best]
    chosen = np.flatnonzero(counted)
    found = peaks.pick(chosen)
    labelled = int((~still.ignored).sum())
    probabilities = 1 / (1 + np.exp(-(slope * found.logits + offset)))
    return Judged(found.logits, probabilities, right[chosen], overlaps[chosen], labelled)


def _overlap(one: Float[Array, "4"], other: Float[Array, "4"]) -> float:
    low, high = np.maximum(one[:2], other[:2]), np.minimum(one[2:], other[2:])
    shared = np.prod(np.maximum(high - low, 0))
    areas = sum(np.prod(box[2:] - box[:2]) for box in (one, other))
    return float(shared / (areas - shared))
