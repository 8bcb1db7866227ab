"""What a map costs in processor time and storage, and what that makes of many of them.

    python -m benchmarks.catalog.unit_costs --json docs/bench/unit_costs.json

The costs are measured; the plans multiply them by the assumptions in `Assumptions`.
"""

import hashlib
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import typer

from benchmarks.hover_videos import film_place
from benchmarks.pipeline import build
from benchmarks.results import JsonFile, Row, print_rows, write_rows
from benchmarks.synthetic import write_video
from geoaim.aim.aim import AIM
from geoaim.aim.files import write_aim
from geoaim.imagery.alignment.pipeline import align_tiles
from geoaim.tracks.formats import read_tracks

SAMPLES = Path("samples")
FRAMES = 90  # of a clip; a longer one costs no more, since at most 64 frames are used
HASHED_MEGABYTES = 256
HOUR_S, DAY_S = 3600.0, 86400.0


@dataclass(frozen=True)
class Assumptions:
    """What the plans assume of a country and of a day's recordings."""

    country_km2: float = 357_000.0
    road_share: float = 0.12  # of the country within 25 m of a road, where tracks can be
    imagery_m: float = 0.2  # per pixel
    recordings_per_day: int = 1000
    minutes: float = 10.0  # of a recording
    megabits: float = 60.0  # a second of 4K video
    network_gigabits: float = 1.0  # a second, of one machine
    cores: int = 16  # of one machine


@dataclass(frozen=True)
class Costs:
    """Measured on this machine."""

    build_s: float  # processor seconds of one map of 4K video
    build_bytes: float  # of its file
    align_s_per_km2: float  # processor seconds to align imagery to tracks
    imagery_bytes_per_pixel: float  # of the aligned map's file
    hash_bytes_per_s: float


def measure_costs(folder: Path) -> Costs:
    """Measure the costs of one map of video and of one of imagery.

    Args:
        folder: for temporary files.

    Returns:
        The costs, in processor time of one thread.
    """
    cv2.setNumThreads(1)
    video = film_place("junction", size="4k", count=FRAMES)
    clip = write_video(video, folder / "clip.mp4", megabits=60.0, keyframe_interval=30)
    build_s, built = _time_processor(lambda: build(clip))
    tracks = read_tracks(SAMPLES / "tracks.csv")
    align_s, aligned = _time_processor(lambda: align_tiles(SAMPLES / "ortho.tif", tracks=tracks))
    pixels = aligned.image.shape[0] * aligned.image.shape[1]
    content = np.random.default_rng(0).bytes(HASHED_MEGABYTES * 2**20)
    hash_s, _ = _time_processor(lambda: hashlib.sha256(content).digest())
    return Costs(
        build_s=build_s,
        build_bytes=_measure_file(built, folder / "built.tif"),
        align_s_per_km2=align_s / (pixels * aligned.resolution**2 / 1e6),
        imagery_bytes_per_pixel=_measure_file(aligned, folder / "aligned.tif") / pixels,
        hash_bytes_per_s=len(content) / hash_s,
    )


def plan_country(costs: Costs, assumed: Assumptions) -> list[Row]:
    """Plan a country's imagery, all of it or along its roads, aligned to the tracks of vehicles.

    Args:
        costs: of this machine.
        assumed: the country.

    Returns:
        A row each: area, core hours, storage, and days of one machine by core and by network.
    """
    rows: list[Row] = []
    for area, share in (("all of it", 1.0), ("along roads", assumed.road_share)):
        km2 = assumed.country_km2 * share
        pixels = km2 * 1e6 / assumed.imagery_m**2
        hours, stored = km2 * costs.align_s_per_km2 / HOUR_S, pixels * costs.imagery_bytes_per_pixel
        moved = pixels * 3 * 8 + stored * 8  # uncompressed imagery in, maps out
        rows.append(
            {
                "area": area,
                "km²": round(km2),
                "core hours": round(hours),
                "maps, TB": round(stored / 1e12, 1),
                **_compare_limits(hours, moved, assumed),
            }
        )
    return rows


def plan_recordings(costs: Costs, assumed: Assumptions) -> list[Row]:
    """Plan the recordings of one day.

    Args:
        costs: of this machine.
        assumed: the recordings.

    Returns:
        One row: core hours, storage, and days of one machine by core and by network.
    """
    count = assumed.recordings_per_day
    read = count * assumed.minutes * 60 * assumed.megabits * 1e6 / 8
    hours = (count * costs.build_s + read / costs.hash_bytes_per_s) / HOUR_S
    stored = count * costs.build_bytes
    return [
        {
            "recordings": count,
            "videos, TB": round(read / 1e12, 1),
            "core hours": round(hours, 1),
            "of these to hash": round(read / costs.hash_bytes_per_s / HOUR_S, 1),
            "maps, TB": round(stored / 1e12, 3),
            **_compare_limits(hours, (read + stored) * 8, assumed),
        }
    ]


def _compare_limits(hours: float, bits: float, assumed: Assumptions) -> dict[str, Any]:
    by_cores = hours / assumed.cores / 24
    by_network = bits / (assumed.network_gigabits * 1e9) / DAY_S
    return {
        "days of one machine, by cores": round(by_cores, 2),
        "by network": round(by_network, 2),
        "binds first": "cores" if by_cores > by_network else "network",
    }


def _time_processor(method: Callable[[], Any]) -> tuple[float, Any]:
    start = time.process_time()
    result = method()
    return time.process_time() - start, result


def _measure_file(aim: AIM, path: Path) -> int:
    write_aim(aim, path)
    return path.stat().st_size


def main(json: JsonFile = None) -> None:
    """Measure the costs; print them and the plans; write JSON if asked."""
    assumed = Assumptions()
    with TemporaryDirectory() as folder:
        costs = measure_costs(Path(folder))
    country, recordings = plan_country(costs, assumed), plan_recordings(costs, assumed)
    for rows in ([asdict(costs)], country, recordings):
        print_rows(rows)
    write_rows(
        [asdict(costs)],
        json,
        command="python -m benchmarks.catalog.unit_costs",
        assumptions=asdict(assumed),
        country=country,
        recordings=recordings,
    )


if __name__ == "__main__":
    typer.run(main)
