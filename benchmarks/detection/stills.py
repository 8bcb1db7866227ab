"""Stills of others with boxes, which judge; those under CC BY may train as well."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from benchmarks.data import read_image, require_data
from benchmarks.detection.examples import HIDDEN, degrade
from benchmarks.detection.scenes import draw_scene
from benchmarks.detection.vehicles import get_corners
from geoaim.detection.network import RESOLUTION

DRAWN_PIXELS = 224  # side of a drawn still
BORDER = 2.0  # metres at the rim where vehicles are cut, and labelled in part only


@dataclass(frozen=True)
class StillSet:
    """Stills of one place: where they lie, their scale, who may learn from them."""

    name: str
    folder: str
    pattern: str
    resolution: float  # metres per pixel, by the lengths of cars
    ignored: tuple[int, ...] = ()  # classes of what is not looked for: motorcycles


# shares of the width up to which a still trains, and from which on it is for validation; between
# lies what drifts from one side to the other while an aeroplane passes (2.5 m in Munich)
SPLIT = (0.62, 0.66)


@dataclass(frozen=True, eq=False)
class Still:
    """A still with upright boxes around vehicles."""

    image: UInt8[Array, "H W 3"]
    resolution: float
    boxes: Float[Array, "N 4"]  # left, top, right, bottom; pixels
    ignored: Bool[Array, " N"]  # found or not, they count neither way
    name: str


# Nobody states the scales. Munich: rails lie 1.50 m apart, 12.7 pixels (3 %). Songdo: boxes of cars
# are 4.98 m long in the same people's tracks, and 88 and 95 pixels here (4 %). Minsk: by the labels
# of cars, which are taken to be 4.5 m long (10 %).
TRAINING = (
    StillSet("Munich, street 02", "munich_street02", "*.jpg", 0.118),
    StillSet("Songdo, still 972", "songdo_stills", "00972.jpg", 0.0555, (3,)),
)
JUDGING = (
    StillSet("Minsk, junction", "minsk_junction", "*.jpg", 0.055),
    StillSet("Minsk, street", "minsk_street", "*.jpg", 0.072),
    StillSet("Munich, MOS 74", "munich_mos074", "*.jpg", 0.118),
    StillSet("Songdo, still 3", "songdo_stills", "00003.jpg", 0.0525, (3,)),
)


def read_stills(stills: StillSet) -> Iterator[Still]:
    """Read the stills of a place, in order."""
    folder = require_data("hover") / stills.folder
    for path in sorted(folder.glob(stills.pattern)):
        yield _read_still(path, stills)


def _read_still(path: Path, stills: StillSet) -> Still:
    image = read_image(path)
    height, width = image.shape[:2]
    rows = np.loadtxt(path.with_suffix(".txt"), ndmin=2)
    centres, sizes = rows[:, 1:3] * [width, height], rows[:, 3:5] * [width, height]
    rim = BORDER / stills.resolution
    cut = (centres < rim).any(1) | (centres > np.array([width, height]) - rim).any(1)
    ignored = cut | np.isin(rows[:, 0], stills.ignored)
    boxes = np.concatenate([centres - sizes / 2, centres + sizes / 2], axis=1)
    return Still(image, stills.resolution, boxes, ignored, path.stem)


def split(still: Still) -> tuple[Still, Still]:
    """Split a still into a part to train on and one to validate with."""
    width = still.image.shape[1]
    return _crop(still, 0, int(SPLIT[0] * width)), _crop(still, int(SPLIT[1] * width), width)


def _crop(still: Still, start: int, end: int) -> Still:
    boxes = still.boxes - [start, 0, start, 0]
    middles, rim = (boxes[:, 0] + boxes[:, 2]) / 2, BORDER / still.resolution
    near = (middles > -2 * rim) & (middles < end - start + 2 * rim)
    cut = (middles < rim) | (middles > end - start - rim)
    image = np.ascontiguousarray(still.image[:, start:end])
    return Still(image, still.resolution, boxes[near], (still.ignored | cut)[near], still.name)


# Kampala, OpenAerialMap, CC BY 4.0: where vehicles stand, or what may be one (right and down in
# pixels of 0.149 m from the first tile), looked at by eye. The rest has none.
KAMPALA_TILES = ((1238424, 1046544, 4, 4), (1238448, 1046528, 12, 8))  # first x, y; columns, rows
KAMPALA_VEHICLES = (
    ((255, 72), (322, 122)),
    (
        *((96, 98), (445, 90), (484, 114), (102, 229), (116, 220), (268, 324), (126, 409)),
        *((421, 391), (709, 223), (708, 266), (759, 330), (760, 361), (703, 469), (795, 316)),
        *((774, 332), (775, 366), (1491, 254), (918, 380), (1142, 74), (214, 590), (280, 706)),
        *((309, 774), (328, 940), (504, 827), (488, 875), (742, 1008), (1194, 744), (1478, 558)),
        *((1450, 621), (1380, 774)),
    ),
)
AROUND = 5.0  # metres to each side of such a place that count neither way


def read_roofs() -> list[Still]:
    """Read roofs, walls, trees and yards of Kampala, where vehicles count neither way."""
    folder = require_data("tiles/kampala_xyz")
    stills = []
    for (x, y, columns, rows), places in zip(KAMPALA_TILES, KAMPALA_VEHICLES, strict=True):
        names = [[f"OAM-{x + i}-{y + j}-21.png" for i in range(columns)] for j in range(rows)]
        tiles = [np.hstack([read_image(folder / name) for name in row]) for row in names]
        image = cv2.resize(np.vstack(tiles), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        reach = AROUND / 0.149
        boxes = np.array([[u - reach, v - reach, u + reach, v + reach] for u, v in places])
        stills.append(Still(image, 0.149, boxes, np.ones(len(boxes), bool), "Kampala"))
    return stills


# Vienna, Schoenbrunn, orthophoto of the city, CC BY 4.0: rows above are streets; left, top, right,
# bottom of parts with vehicles, or with what may be one, looked at by eye. The rest has none.
VIENNA_TOP = 190  # pixels
VIENNA_VEHICLES = (
    *((0, 260, 80, 458), (240, 225, 400, 325), (375, 280, 712, 515), (355, 450, 385, 490)),
    *((280, 425, 345, 460), (678, 533, 712, 560), (960, 190, 1667, 560), (1350, 560, 1667, 1060)),
    *((195, 394, 235, 434), (792, 270, 832, 324), (1322, 893, 1362, 933), (1302, 997, 1342, 1037)),
)


def read_palace() -> Still:
    """Read roofs, gardens and yards of Vienna, where vehicles count neither way."""
    image = read_image(require_data("georef/vienna") / "44_2_op_2023_30cm.tif")[VIENNA_TOP:]
    boxes = np.array(VIENNA_VEHICLES, float) - [0, VIENNA_TOP, 0, VIENNA_TOP]
    return Still(image, 0.3, boxes, np.ones(len(boxes), bool), "Vienna")


def draw_stills(number: int) -> Iterator[Still]:
    """Draw scenes that no network was trained on, as stills with upright boxes."""
    for seed in range(number):
        generator = np.random.default_rng(30_000 + seed)
        image, boxes, hidden = draw_scene(DRAWN_PIXELS, RESOLUTION, generator)
        seen = degrade(image, np.random.default_rng(seed)).transpose(1, 2, 0)
        corners = np.array([get_corners(*box) for box in boxes.tolist()]).reshape(-1, 4, 2)
        bounds = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
        rim = BORDER / RESOLUTION
        cut = (boxes[:, :2] < rim).any(1) | (boxes[:, :2] > DRAWN_PIXELS - rim).any(1)
        image = np.ascontiguousarray(seen * 255).astype(np.uint8)
        yield Still(image, RESOLUTION, bounds, cut | (hidden > HIDDEN), f"drawn {seed}")
