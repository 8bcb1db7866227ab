"""Real pictures laid on each other, for the benchmark of alignment."""

from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.bench.alignment_pairs import Pair, error, misplaced
from geoaim.errors import AlignmentError
from geoaim.geometry import transform_points
from geoaim.grid import Grid
from geoaim.imagery.alignment.by_image import align_image
from geoaim.imagery.alignment.template_matching import reduce_to_grey, resample_grey
from geoaim.imagery.mosaic import read_imagery


def rotterdam(folder: Path, trials: int = 5) -> list[dict[str, Any]]:
    """Panchromatic and multispectral pictures; ECC on their brightness is the reference."""
    rows = []
    generator = np.random.default_rng(7)
    for number in (1, 2, 3):
        pan, coarse = (
            read_imagery(folder / f"pairs/rotterdam_pan_ms/{kind}{number}.tif")
            for kind in ("pan", "ms")
        )
        world, corners = pan.world, pan.corners
        coarse = read_imagery(
            folder / f"pairs/rotterdam_pan_ms/ms{number}.tif", world=world, corners=corners
        )
        pair = Pair(f"rotterdam {number}", pan, coarse, np.eye(3))
        reference = _by_brightness(pair)
        start = align_image(coarse, pan)
        moved = [misplaced(pair, generator) for _ in range(trials)]
        apart = []
        for case in moved:
            with suppress(AlignmentError):
                found = align_image(case.picture, pan)
                back = np.linalg.inv(start.true_from_stated) @ found.true_from_stated
                apart.append(error(case, back))
        rows.append(
            {
                "pair": pair.name,
                "pixel, m": coarse.resolution,
                "stated place is off by, m": float(np.linalg.norm(reference)),
                "from ECC, m": float(np.linalg.norm(start.shift - reference)),
                "misplacements": trials,
                "refused": trials - len(apart),
                "come back to, m (worst)": max(apart, default=None),
                "stated uncertainty, m": start.uncertainty,
                "windows": start.evidence["windows"],
                "that agree": start.evidence["windows_agreeing"],
            }
        )
    return rows


def _by_brightness(pair: Pair) -> Float[Array, "2"]:
    """The shift in metres by ECC (Evangelidis and Psarakis 2008) on what both show, from 0."""
    step = 0.5
    low, high = pair.aim.corners.min(axis=0), pair.aim.corners.max(axis=0)
    side = int((high - low).min() / step)
    matrix = np.array([[step, 0, low[0]], [0, -step, high[1]], [0, 0, 1.0]])
    grid = Grid((side, side), matrix, pair.aim.world)
    views = []
    for shown in (pair.aim, pair.picture):
        grey, known = resample_grey(reduce_to_grey(shown, step), np.eye(3), grid)
        views.append(cv2.GaussianBlur(np.where(known, grey, 0).astype(np.float32), (0, 0), 1.5))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 300, 1e-7)
    start = np.eye(2, 3, dtype=np.float32)
    whole = np.full(views[0].shape, 255, np.uint8)
    one, two = views
    _, found = cv2.findTransformECC(one, two, start, cv2.MOTION_TRANSLATION, stop, whole, 5)
    return -found[:, 2] * [step, -step]


def zooms(folder: Path) -> list[dict[str, Any]]:
    """Tiles of three zooms of one place laid on each other: by how much they are said to be off."""
    from geoaim.imagery.tiles import Tiles

    tiles = folder / "tiles/kampala_xyz"
    whole = read_imagery(Tiles(tiles, zoom=19))
    known = (whole.coverage > 0).astype(np.uint8)
    _, _, patches, _ = cv2.connectedComponentsWithStats(known)
    left, top, width, height, _ = max(patches[1:].tolist(), key=lambda patch: patch[4])
    corners = transform_points(
        whole.world_from_image,
        np.array([[left, top], [left + width, top + height]], np.float64),
    )
    rows = []
    for zoom, finer in ((20, 21), (19, 20), (19, 21)):
        coarse, other = (
            read_imagery(Tiles(tiles, zoom=z), world=whole.world, corners=corners)
            for z in (zoom, finer)
        )
        try:
            found = align_image(coarse, other)
            off = float(np.linalg.norm(found.shift)) / coarse.resolution
        except AlignmentError as why:
            off = None
            print(f"z{zoom} on z{finer}: {why}")
        rows.append({"zooms": f"z{zoom} on z{finer}", "apart, px of the coarser": off})
    return rows
