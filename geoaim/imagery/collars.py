"""Collars: plain white or black around an image, in a file that does not say it shows nothing."""

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, UInt8
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.errors import warn
from geoaim.base.raster_files import open_raster_file

MAX_BLACK, MIN_WHITE = 4, 251  # grey levels of a collar in all bands, after lossy compression
MIN_COLLAR_SHARE = 0.01  # share of the image below which a plain patch at its edge is no collar
MAX_COLLAR_SHARE = 0.95  # of an image that is nearly all plain, nothing is left out
MAX_SIDE_PX = 2048  # longer side of the reduced image in which patches are joined
OPENING_PX = 5  # narrower parts are no collar, at full resolution
FRINGE_PX = 3  # width of the strip beside a collar that resampling and compression blend with it


def hide_collars(aim: AIM, name: str | None) -> AIM:
    """Give plain white or black at the edge of an image the coverage 0."""
    covered = aim.coverage > 0
    collars = find_collars(aim.image, covered) & covered
    share = collars.sum() / np.count_nonzero(covered)
    if not 0 < share < MAX_COLLAR_SHARE:
        return aim
    if name is not None:
        warn(
            f"{name}: {share:.0%} of the image is plain white or black at its edge, and no mask or "
            "exact nodata value says so: taken as showing nothing; nodata='none' (--nodata none) "
            "keeps it"
        )
    image = np.where(collars[..., None], np.uint8(0), aim.image)
    return replace(aim, image=image, coverage=np.where(collars, np.uint16(0), aim.coverage))


def find_collars(image: UInt8[Array, "H W 3"], covered: Bool[Array, "H W"]) -> Bool[Array, "H W"]:
    """Find plain white or black that reaches the edge of an image."""
    found = np.zeros(covered.shape, bool)
    for plain in ((image >= MIN_WHITE).all(axis=2), (image <= MAX_BLACK).all(axis=2)):
        patches = _open(plain & covered)
        if patches.mean() < MIN_COLLAR_SHARE:
            continue
        at_edge = _keep_at_edge(patches, ~covered)
        if at_edge.mean() >= MIN_COLLAR_SHARE:
            found |= at_edge
    if not found.any():
        return found
    square = np.ones((2 * FRINGE_PX + 1,) * 2, np.uint8)
    return cv2.dilate(found.astype(np.uint8), square) > 0


def _open(mask: Bool[Array, "H W"]) -> Bool[Array, "H W"]:
    square = np.ones((OPENING_PX, OPENING_PX), np.uint8)
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, square) > 0


def _keep_at_edge(patches: Bool[Array, "H W"], outside: Bool[Array, "H W"]) -> Bool[Array, "H W"]:
    """Keep patches that touch the border of the image or pixels that show nothing."""
    height, width = patches.shape
    scale = min(1.0, MAX_SIDE_PX / max(height, width))
    size = max(round(width * scale), 1), max(round(height * scale), 1)
    small, beyond = (
        cv2.resize(x.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
        for x in (patches, outside)
    )
    edge = cv2.copyMakeBorder(beyond, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=255)
    reached = cv2.dilate(edge, np.ones((3, 3), np.uint8))[1:-1, 1:-1] > 0
    _, numbers = cv2.connectedComponents((small > 127).astype(np.uint8))
    kept = np.isin(numbers, np.setdiff1d(np.unique(numbers[reached]), [0]))
    whole = cv2.resize(kept.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    return patches & (whole > 0)


TileFile = tuple[int, int, Path]  # x, y and file


def leave_out_placeholders(tiles: Sequence[TileFile], name: str) -> list[TileFile]:
    """Leave out tiles whose pixels are those of another tile, with a warning.

    Ground that a camera sees never repeats to the last grey level; what does is the picture by
    which a service says that it has none, or an area without any detail.
    """
    sizes = Counter(file.stat().st_size for _, _, file in tiles)
    # A file of another size may hold the same pixels, but then it is of another encoder.
    suspects = [tile for tile in tiles if sizes[tile[2].stat().st_size] > 1]
    pictures = {tile: _hash_pixels(tile[2]) for tile in suspects}
    counts = Counter(pictures.values())
    repeated = {tile for tile, picture in pictures.items() if picture and counts[picture] > 1}
    if repeated:
        warn(
            f"{name}: {len(repeated)} of {len(tiles)} tiles are the same picture as another one, "
            "as 'no imagery here' is, or plain water; they are left out and their area stays empty"
        )
    return [tile for tile in tiles if tile not in repeated]


def _hash_pixels(file: Path) -> str:
    """Hash the pixels of a picture; "" where it is transparent, or cannot be read."""
    try:
        with open_raster_file(file) as dataset:
            pixels = np.ascontiguousarray(dataset.read())
    except Exception:  # GDAL's errors are of several kinds; the reader of the tile reports them
        return ""
    if len(pixels) in (2, 4) and not pixels[-1].any():
        return ""
    return hashlib.sha256(pixels.tobytes() + str(pixels.shape).encode()).hexdigest()
