"""The network that finds vehicles: run by OpenCV, and what its output says."""

import json
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array
from scipy.spatial import cKDTree

MODEL = Path(__file__).parent / "models" / "vehicles.onnx"
RESOLUTION = 0.265  # metres per pixel of the pictures that the network was trained on
STRIDE = 4  # pixels of a cell of its output
STEP = 8  # its input's height and width are multiples of it, pixels
LENGTH, WIDTH = 4.5, 1.85  # metres: it gives sizes as logarithms of shares of them
REACH = 96  # pixels around a place that its output depends on
TILE = 2048  # pixels of a side that are computed at once: 300 MB


@dataclass(frozen=True, eq=False)
class Peaks:
    """Vehicles in a picture of the network's resolution; pixels, angles clockwise from right."""

    centres: Float[Array, "N 2"]
    headings: Float[Array, " N"]
    lengths: Float[Array, " N"]
    widths: Float[Array, " N"]
    logits: Float[Array, " N"]  # log odds that the network gives, not calibrated

    def get_corners(self) -> Float[Array, "N 4 2"]:
        """Get corners in pixels: the first side points forward."""
        along = np.stack([np.cos(self.headings), np.sin(self.headings)], axis=1)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        ahead, aside = along * self.lengths[:, None] / 2, across * self.widths[:, None] / 2
        signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        return np.stack([self.centres + a * ahead + b * aside for a, b in signs], axis=1)

    def pick(self, rows: Array) -> "Peaks":
        """Pick some of the vehicles by their numbers."""
        return Peaks(
            self.centres[rows],
            self.headings[rows],
            self.lengths[rows],
            self.widths[rows],
            self.logits[rows],
        )


_nets = threading.local()  # a network of OpenCV serves one thread at a time


def _get_net(model: Path) -> cv2.dnn.Net:
    if model not in vars(_nets).setdefault("by_path", {}):
        _nets.by_path[model] = cv2.dnn.readNetFromONNX(str(model))
    return _nets.by_path[model]


@cache
def read_calibration(model: Path = MODEL) -> tuple[float, float]:
    """Read the slope and offset that turn the network's log odds into those of being right."""
    line = json.loads(model.with_suffix(".json").read_text("utf-8"))["calibration"]
    return line["slope"], line["offset"]


def find_peaks(image: UInt8[Array, "H W 3"], lowest: float, model: Path = MODEL) -> Peaks:
    """Find vehicles in an RGB picture of `RESOLUTION`, tile by tile where it is large.

    Args:
        image: RGB.
        lowest: log odds of the network below which nothing is returned.
        model: the network, ONNX.
    """
    parts = []
    for top in _cut(image.shape[0]):
        for left in _cut(image.shape[1]):
            tile = image[top : top + TILE, left : left + TILE]
            peaks = decode(_run(tile, model), lowest)
            centres = peaks.centres + np.array([left, top])
            own = _is_own(centres[:, 0], left, image.shape[1])
            own &= _is_own(centres[:, 1], top, image.shape[0])
            moved = Peaks(centres, peaks.headings, peaks.lengths, peaks.widths, peaks.logits)
            parts.append(moved.pick(np.flatnonzero(own)))
    joined = join_peaks(parts)
    return joined.pick(_drop_doubles(joined))


def join_peaks(parts: Sequence[Peaks]) -> Peaks:
    """Join the vehicles of several pictures, one after the other."""
    fields = zip(*(vars(part).values() for part in parts), strict=True)
    return Peaks(*(np.concatenate(field) for field in fields))


def _cut(size: int) -> range:
    return range(0, max(size - 2 * REACH, 1), TILE - 2 * REACH)


def _is_own(place: Float[Array, " N"], start: int, size: int) -> Bool[Array, " N"]:
    """Say which places belong to a tile; what is nearer its edge belongs to its neighbour."""
    low = 0 if start == 0 else start + REACH
    high = np.inf if start + TILE >= size else start + TILE - REACH
    return (place >= low) & (place < high)


def _run(tile: UInt8[Array, "H W 3"], model: Path) -> Float32[Array, "9 h w"]:
    """Run the network over a picture, whose edge is repeated to a size that it takes."""
    height, width = tile.shape[:2]
    padded = cv2.copyMakeBorder(
        tile, 0, -height % STEP, 0, -width % STEP, borderType=cv2.BORDER_REPLICATE
    )
    net = _get_net(model)
    net.setInput(cv2.dnn.blobFromImage(padded, 1 / 255))
    return net.forward()[0]


def decode(output: Float32[Array, "9 h w"], lowest: float) -> Peaks:
    """Read the vehicles from the network's output: where the heat is highest around."""
    heat = output[0]
    is_peak = (heat == cv2.dilate(heat, np.ones((3, 3), np.uint8))) & (heat > lowest)
    rows, columns = np.nonzero(is_peak)
    offset_u, offset_v, length, width, cos2, sin2, c, s = output[1:, rows, columns].astype(float)
    centres = np.stack([columns + 0.5 + offset_u, rows + 0.5 + offset_v], axis=1) * STRIDE
    heading = np.arctan2(sin2, cos2) / 2
    heading += np.pi * (np.cos(heading) * c + np.sin(heading) * s < 0)
    # sizes far outside those of vehicles stand for nothing: exp must not overflow
    length, width = np.exp(np.clip([length, width], -2, 2))
    lengths, widths = length * LENGTH / RESOLUTION, width * WIDTH / RESOLUTION
    return Peaks(centres, heading, lengths, widths, heat[rows, columns].astype(float))


def _drop_doubles(peaks: Peaks) -> Array:
    """Get the numbers of vehicles whose middle lies in no better one, and the other way round."""
    along = np.stack([np.cos(peaks.headings), np.sin(peaks.headings)], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    # 0.8 of half a size: vehicles stand side by side at no less than twice that
    half = 0.8 / 2 * np.stack([peaks.lengths, peaks.widths], axis=1)
    kept = np.ones(len(half), bool)
    reach = float(np.hypot(*half.T).max(initial=0))
    pairs = cKDTree(peaks.centres).query_pairs(reach, output_type="ndarray")
    between = peaks.centres[pairs[:, 1]] - peaks.centres[pairs[:, 0]]
    inside = np.zeros(len(pairs), bool)
    for rows in pairs.T:
        offset = [(between * axis[rows]).sum(axis=1) for axis in (along, across)]
        inside |= (np.abs(np.stack(offset, axis=1)) < half[rows]).all(axis=1)
    rank = np.argsort(np.argsort(-peaks.logits, kind="stable"))
    ranks = np.sort(rank[pairs[inside]], axis=1)
    by_rank = np.argsort(rank)
    # each pair comes after all that may drop its better one
    for better, worse in by_rank[ranks[np.argsort(ranks[:, 0], kind="stable")]].tolist():
        kept[worse] &= not kept[better]
    return np.flatnonzero(kept)
