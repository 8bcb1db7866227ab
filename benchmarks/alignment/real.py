"""Alignment of real pictures to each other, and of pictures to tracks, for the benchmark."""

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.alignment.pairs import Pair, measure_error, misplace_picture
from benchmarks.synthetic.roads.layouts import STANDARD_KINDS
from geoaim.aim.aim import AIM
from geoaim.aim.position import CHI2_2D
from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import make_similarity, transform_points
from geoaim.base.grid import Grid
from geoaim.imagery.alignment.by_image import align_image
from geoaim.imagery.alignment.by_tracks import align_tracks
from geoaim.imagery.alignment.template_matching import reduce_to_grey, resample_grey
from geoaim.imagery.mosaic import read_imagery
from geoaim.tracks.formats import read_geotrax
from geoaim.tracks.tracks import Tracks

ECC_RESOLUTION = 0.5  # m a pixel
MAX_SHIFT_M, MAX_ROTATION_DEGREES = 10.0, 3.0
SONGDO_ROAD_RADIANS = np.radians(50.2)  # direction of the road from east
SONGDO_MARGIN_M = 40.0  # margin of the orthophoto around the tracks


def measure_rotterdam(folder: Path, trials: int = 5) -> list[dict[str, Any]]:
    """Align panchromatic and multispectral pictures in the folder of real data; a row for each.

    The reference is ECC on their brightness.
    """
    rows = []
    generator = np.random.default_rng(7)
    for number in (1, 2, 3):
        pan = read_imagery(folder / f"pairs/rotterdam_pan_ms/pan{number}.tif")
        coarse = read_imagery(
            folder / f"pairs/rotterdam_pan_ms/ms{number}.tif", world=pan.world, corners=pan.corners
        )
        pair = Pair(f"rotterdam {number}", pan, coarse, np.eye(3))
        reference = _estimate_shift_by_ecc(pair)
        start = align_image(coarse, pan)
        errors = []
        for case in [misplace_picture(pair, generator) for _ in range(trials)]:
            with suppress(AlignmentError):
                alignment = align_image(case.picture, pan)
                back = np.linalg.inv(start.true_from_stated) @ alignment.true_from_stated
                errors.append(measure_error(case, back))
        rows.append(
            {
                "pair": pair.name,
                "pixel, m": coarse.resolution,
                "offset by ECC, m": float(np.linalg.norm(reference)),
                "difference from ECC, m": float(np.linalg.norm(start.shift - reference)),
                "misplacements": trials,
                "refused": trials - len(errors),
                "largest deviation after misplacement, m": max(errors, default=None),
                "uncertainty, m": start.uncertainty,
                "windows": start.evidence["windows"],
                "windows that agree": start.evidence["windows_agreeing"],
            }
        )
    return rows


def _estimate_shift_by_ecc(pair: Pair) -> Float[Array, "2"]:
    """The shift in metres by ECC (Evangelidis and Psarakis 2008), started at 0."""
    low, high = pair.aim.corners.min(axis=0), pair.aim.corners.max(axis=0)
    side, step = int((high - low).min() / ECC_RESOLUTION), ECC_RESOLUTION
    matrix = np.array([[step, 0, low[0]], [0, -step, high[1]], [0, 0, 1.0]])
    grid = Grid((side, side), matrix, pair.aim.world)
    views = []
    for aim in (pair.aim, pair.picture):
        grey, valid = resample_grey(reduce_to_grey(aim, step), np.eye(3), grid)
        views.append(cv2.GaussianBlur(np.where(valid, grey, 0).astype(np.float32), (0, 0), 1.5))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 300, 1e-7)
    start = np.eye(2, 3, dtype=np.float32)
    mask = np.full(views[0].shape, 255, np.uint8)
    one, two = views
    _, warp = cv2.findTransformECC(one, two, start, cv2.MOTION_TRANSLATION, stop, mask, 5)
    return -warp[:, 2] * [step, -step]


def measure_songdo(folder: Path, trials: int = 20) -> list[dict[str, Any]]:
    """Measure alignment to five seconds of real vehicles: a row of errors across their road."""
    tracks = read_geotrax(folder / "tracks/songdo_u/U_video_cut.csv", crs="EPSG:5186")
    points = tracks.states[tracks.present][:, :2]
    corners = np.array([points.min(axis=0) - SONGDO_MARGIN_M, points.max(axis=0) + SONGDO_MARGIN_M])
    ortho = folder / "tracks/songdo_u/ortho_U_25cm_epsg5186.tif"
    picture = read_imagery(ortho, world=tracks.world, corners=corners)
    return [_measure_tracks("songdo", [(picture, tracks)], trials, road=SONGDO_ROAD_RADIANS)]


def measure_synthetic(pairs: Sequence[Pair]) -> list[dict[str, Any]]:
    """Measure alignment to a minute of synthetic traffic: a row for each kind of place."""
    rows = []
    for kind in STANDARD_KINDS:
        own = [pair for pair in pairs if pair.name.startswith(f"{kind} ")]
        cases = [(pair.picture, pair.tracks) for pair in own if pair.tracks is not None]
        rows.append(_measure_tracks(f"made, {kind}", cases, 2))
    return rows


def _measure_tracks(
    name: str, cases: Sequence[tuple[AIM, Tracks]], trials: int, *, road: float | None = None
) -> dict[str, Any]:
    """Misplace pictures and align them to tracks; medians of each picture's medians.

    With a road's direction, errors are across it.
    """
    errors, durations, inside = [], [], 0
    for picture, tracks in cases:
        own = [one for one in align_trials(picture, tracks, trials) if one is not None]
        inside += sum(is_inside for _, is_inside, _ in own)
        across = np.eye(2) if road is None else np.array([[-np.sin(road)], [np.cos(road)]])
        errors.append([float(np.linalg.norm(error @ across)) for error, _, _ in own])
        durations.append([duration for _, _, duration in own])
    return {
        "tracks": name,
        "cases": trials * len(cases),
        "refused": trials * len(cases) - sum(len(own) for own in errors),
        "error, m, median": float(np.median([np.median(own) for own in errors if own])),
        "largest, m": max(max(own) for own in errors if own),
        "in the 95 % region": inside,
        "s": float(np.median([np.median(own) for own in durations if own])),
    }


def align_trials(
    picture: AIM, tracks: Tracks, trials: int
) -> Iterator[tuple[Float[Array, "2"], bool, float] | None]:
    """Yield error in metres, whether the stated region holds it, and seconds; None if refused."""
    generator = np.random.default_rng(11)
    points = tracks.states[tracks.present][:, :2]
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    for _ in range(trials):
        angle, shift = generator.uniform(0, 2 * np.pi), generator.uniform(0, MAX_SHIFT_M)
        rotation = np.radians(generator.uniform(-MAX_ROTATION_DEGREES, MAX_ROTATION_DEGREES))
        matrix = make_similarity(center, rotation, 1.0)
        matrix[:2, 2] += shift * np.array([np.cos(angle), np.sin(angle)])
        moved = replace(picture, world_from_image=matrix @ picture.world_from_image)
        start = time.process_time()
        try:
            alignment = align_tracks(moved, tracks)
        except AlignmentError:
            yield None
            continue
        duration = time.process_time() - start
        total = alignment.true_from_stated @ matrix
        error = transform_points(total, alignment.center[None])[0] - alignment.center
        is_inside = bool(error @ np.linalg.solve(alignment.covariance, error) < CHI2_2D)
        yield error, is_inside, duration
