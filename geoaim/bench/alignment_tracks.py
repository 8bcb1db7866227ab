"""Alignment of pictures to tracks alone, for the alignment benchmark."""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from geoaim.aim import AIM
from geoaim.bench.alignment_pairs import Pair
from geoaim.errors import AlignmentError
from geoaim.geometry import make_similarity, transform_points
from geoaim.imagery.alignment.by_tracks import align_tracks
from geoaim.imagery.alignment.result import CHI2_2D
from geoaim.imagery.mosaic import read_imagery
from geoaim.synthetic.roads.layouts import STANDARD_KINDS
from geoaim.track_formats import read_geotrax
from geoaim.tracks import Tracks

MAX_SHIFT_M, MAX_ROTATION_DEGREES = 10.0, 3.0
SONGDO_ROAD_RADIANS = np.radians(50.2)  # direction of the road from east
SONGDO_MARGIN_M = 40.0  # of the orthophoto around the tracks


def measure_songdo(folder: Path, trials: int = 20) -> list[dict[str, Any]]:
    """Measure five seconds of vehicles on a real orthophoto, across their road."""
    tracks = read_geotrax(folder / "tracks/songdo_u/U_video_cut.csv", crs="EPSG:5186")
    points = tracks.states[tracks.present][:, :2]
    corners = np.array([points.min(axis=0) - SONGDO_MARGIN_M, points.max(axis=0) + SONGDO_MARGIN_M])
    ortho = folder / "tracks/songdo_u/ortho_U_25cm_epsg5186.tif"
    picture = read_imagery(ortho, world=tracks.world, corners=corners)
    return [_measure_tracks("songdo", picture, tracks, trials, road=SONGDO_ROAD_RADIANS)]


def measure_synthetic(pairs: Sequence[Pair]) -> list[dict[str, Any]]:
    """Measure a minute of synthetic traffic on pictures of other days, for each kind of place."""
    rows = []
    for kind in STANDARD_KINDS:
        parts = [
            _measure_tracks(kind, pair.picture, pair.tracks, 2)
            for pair in pairs
            if pair.name.startswith(kind) and pair.tracks is not None
        ]
        if not parts:
            continue
        columns = {
            name: [part[name] for part in parts if part[name] is not None] for name in parts[0]
        }
        rows.append(
            {
                "tracks": f"made, {kind}",
                "cases": sum(columns["cases"]),
                "refused": sum(columns["refused"]),
                "error, m, median": float(np.median(columns["error, m, median"])),
                "largest, m": max(columns["largest, m"]),
                "in the 95 % region": sum(columns["in the 95 % region"]),
                "s": float(np.median(columns["s"])),
            }
        )
    return rows


def _measure_tracks(
    name: str, picture: AIM, tracks: Tracks, trials: int, *, road: float | None = None
) -> dict[str, Any]:
    """Misplace a picture and align it to tracks, several times; with a road, errors across it."""
    generator = np.random.default_rng(11)
    errors, inside, durations = [], 0, []
    points = tracks.states[tracks.present][:, :2]
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    for _ in range(trials):
        angle, shift = generator.uniform(0, 2 * np.pi), generator.uniform(0, MAX_SHIFT_M)
        rotation = np.radians(generator.uniform(-MAX_ROTATION_DEGREES, MAX_ROTATION_DEGREES))
        matrix = make_similarity(center, rotation, 1.0)
        matrix[:2, 2] += shift * np.array([np.cos(angle), np.sin(angle)])
        moved = replace(picture, world_from_image=matrix @ picture.world_from_image)
        start = time.perf_counter()
        try:
            alignment = align_tracks(moved, tracks)
        except AlignmentError:
            continue
        durations.append(time.perf_counter() - start)
        total = alignment.true_from_stated @ matrix
        error = transform_points(total, alignment.center[None])[0] - alignment.center
        inside += int(error @ np.linalg.solve(alignment.covariance, error) < CHI2_2D)
        across = error if road is None else error @ [[-np.sin(road)], [np.cos(road)]]
        errors.append(float(np.linalg.norm(across)))
    return {
        "tracks": name,
        "cases": trials,
        "refused": trials - len(errors),
        "error, m, median": float(np.median(errors)) if errors else None,
        "largest, m": max(errors, default=None),
        "in the 95 % region": inside,
        "s": float(np.median(durations)) if durations else None,
    }
