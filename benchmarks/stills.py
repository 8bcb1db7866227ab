"""Real stills for hover videos: cars removed from them, and the same cars cut out as sprites.

The stills (Songdo Vision, CC BY 4.0) are real data: nothing made from them is in the repository.
"""

import os
import tempfile
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from benchmarks.data import read_image, require_data
from geoaim.base.files import atomic_write

STILLS = ("00003", "00972")  # names of the two images of Songdo Vision


def cut_sprites(still: str) -> list[UInt8[Array, "_ _ 4"]]:
    """Cut the cars out of a still of `STILLS`: RGBA, heading right, padded by 2 px."""
    image, boxes = _read_still(still)
    sprites = []
    for left, top, right, bottom in boxes.tolist():
        long, short = max(right - left, bottom - top), min(right - left, bottom - top)
        inside = left > 2 and top > 2 and right < 3838 and bottom < 2158
        if not inside or short < 38 or long > 160 or not 2.0 < long / short < 3.2:
            continue
        rgba = cut_car(image[top:bottom, left:right], 1.02)
        sprites.append(np.pad(rgba, ((2, 2), (2, 2), (0, 0))))
    return sprites


def cut_car(body: UInt8[Array, "h w 3"], size: float) -> UInt8[Array, "_ _ 4"]:
    """Turn an RGB picture of a car to the right and round its corners, which become transparent.

    `size`, 0 to 1, is the share of the picture that the car fills.
    """
    body = np.rot90(body) if len(body) > body.shape[1] else body
    x, y = (np.abs(np.linspace(-1, 1, side)) for side in body.shape[1::-1])
    alpha = ((size - (x[None] ** 6 + y[:, None] ** 6) ** (1 / 6)) * 12).clip(0, 1) * 255
    return np.dstack([body, alpha.astype(np.uint8)])


def read_clean_still(still: str) -> UInt8[Array, "2160 3840 3"]:
    """Read one of the two real drone stills (`STILLS`), its vehicles painted over with road.

    The result is kept in a cache on disk.
    """
    cached = _find_cache_folder() / f"clean-{still}.png"
    if not cached.exists():
        image, boxes = _read_still(still)
        cached.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(cached) as part:
            cv2.imwrite(str(part), _remove_boxes(image, boxes)[..., ::-1])
    return read_image(cached)


def _find_cache_folder() -> Path:
    """$XDG_CACHE_HOME/geoaim-bench, else the same under the folder for temporary files."""
    return Path(os.environ.get("XDG_CACHE_HOME", tempfile.gettempdir())) / "geoaim-bench"


def _read_still(still: str) -> tuple[UInt8[Array, "2160 3840 3"], Array]:
    folder = require_data("hover/songdo_stills")
    image = read_image(folder / f"{still}.jpg")
    centres = np.loadtxt(folder / f"{still}.txt")[:, 1:]
    boxes = centres[:, [0, 1, 0, 1]] + centres[:, [2, 3, 2, 3]] * [-0.5, -0.5, 0.5, 0.5]
    return image, np.rint(boxes.clip(0, 1) * [3840, 2160, 3840, 2160]).astype(int)


def _remove_boxes(image: UInt8[Array, "H W 3"], boxes: Array) -> UInt8[Array, "H W 3"]:
    """Fill each box with the nearby patch that fits best, blended at its rim."""
    limit = np.tile(image.shape[1::-1], 2)
    grown = np.hstack([boxes[:, :2] - 14, boxes[:, 2:] + 14]).clip(0, limit)
    occupied = np.zeros(image.shape[:2], bool)
    for left, top, right, bottom in grown.tolist():
        occupied[top:bottom, left:right] = True
    clean = image.copy()
    for left, top, right, bottom in grown.tolist():
        target = clean[top:bottom, left:right]
        patch = _find_patch(clean, occupied, (left, top, right, bottom))
        if patch is None:
            window = np.zeros(image.shape[:2], np.uint8)
            window[top:bottom, left:right] = 255
            clean = np.asarray(cv2.inpaint(clean, window, 5, cv2.INPAINT_TELEA), np.uint8)
        else:
            weight = _make_ramp(*target.shape[:2])[..., None]
            target[:] = (weight * patch + (1 - weight) * target).astype(np.uint8)
    return clean


def _find_patch(
    image: UInt8[Array, "H W 3"], occupied: Bool[Array, "H W"], box: tuple[int, int, int, int]
) -> UInt8[Array, "h w 3"] | None:
    """Find the vehicle-free patch nearby whose rim and interior resemble the box's rim most."""
    left, top, right, bottom = box
    height, width = bottom - top, right - left
    rows, columns = image.shape[:2]
    inside = np.zeros((height, width), bool)
    inside[10:-10, 10:-10] = True
    rim = image[top:bottom, left:right][~inside][::5].astype(int)
    best, chosen = np.inf, None
    for y in range(max(0, top - 3 * height), min(rows - height, top + 3 * height) + 1, 8):
        for x in range(max(0, left - 4 * width), min(columns - width, left + 4 * width) + 1, 8):
            if occupied[y : y + height : 4, x : x + width : 4].any():
                continue
            patch = image[y : y + height, x : x + width]
            cost = np.abs(patch[~inside][::5] - rim).mean()
            cost += 0.7 * np.abs(patch[inside][::11] - np.median(rim, axis=0)).mean()
            if cost < best:
                best, chosen = float(cost), patch.copy()
    return chosen


def _make_ramp(height: int, width: int) -> Float[Array, "h w"]:
    """1 inside, falling to 0 over the outer 10 px."""
    y, x = (np.minimum(np.arange(n), np.arange(n)[::-1]) for n in (height, width))
    return np.asarray((np.minimum(y[:, None], x) / 10.0).clip(0, 1))
