"""Catalogues: scaling over workers, losses of workers and scheduler, stores, and many rows.

    python -m benchmarks.catalog --json docs/bench/catalog.json

Recordings are synthetic clips of 640 x 360 px, of which three are planted bad ones.
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer

from benchmarks.catalog.losses import measure_losses
from benchmarks.catalog.stores import measure_store
from benchmarks.results import (
    JsonFile,
    Row,
    measure_peak_megabytes,
    print_rows,
    run_in_process,
    write_rows,
)
from benchmarks.synthetic.camera import Hover, SpriteTracks, film, render_frames
from geoaim.base.encode import write_video
from geoaim.catalog import Catalog, Cluster, build_catalog, read_recordings
from geoaim.catalog.pipeline import list_all_inputs, make_plan
from geoaim.catalog.storage import hash_file, make_address

BAD = 3  # planted recordings that give no map
STORED = 20  # recordings in the object store
DISTINCT_CLIPS = 10  # the others are copies of these
SIZE = 360, 640
POINTS = ((40, 30), (600, 50), (580, 320), (60, 330), (300, 180))


def write_recordings(folder: Path, count: int) -> Path:
    """Write clips with control points, and their table.

    Args:
        folder: for the files.
        count: of recordings, the planted bad ones included.

    Returns:
        The table.
    """
    folder.mkdir(parents=True)
    clips = [_film_clip(folder / f"clip_{seed}.mp4", seed) for seed in range(DISTINCT_CLIPS)]
    rows = ["name,video,gcps"]
    for number in range(count - BAD):
        points = folder / f"points_{number}.csv"
        east, north = 583200.0 + 200.0 * (number % 10), 6062200.0 + 200.0 * (number // 10)
        lines = [
            f"p{i},{u},{v},{east + 0.05 * u},{north - 0.05 * v}" for i, (u, v) in enumerate(POINTS)
        ]
        points.write_text("# crs: EPSG:32635\nname,u,v,x,y\n" + "\n".join(lines))
        rows.append(f"place_{number},{clips[number % len(clips)].name},{points.name}")
    (folder / "broken.mp4").write_bytes(clips[0].read_bytes()[:5000])
    (folder / "few.csv").write_text("# crs: EPSG:32635\nname,u,v,x,y\na,1,1,583200,6062200\n")
    rows += ["broken,broken.mp4,points_0.csv", "missing,nowhere.mp4,points_0.csv"]
    rows += [f"few,{clips[0].name},few.csv"]
    table = folder / "recordings.csv"
    table.write_text("\n".join(rows) + "\n")
    return table


def measure_scaling(table: Path, folder: Path) -> list[Row]:
    """Build with one worker and with two; then again, when nothing is left to do."""
    rows: list[Row] = []
    for workers in (1, 2):
        output = folder / f"maps_{workers}"
        seconds, catalog = _time_build(table, output, Cluster(workers=workers))
        again, second = _time_build(table, output, Cluster(workers=workers))
        rows.append(
            {
                "workers": workers,
                "recordings": len(catalog.records),
                "built": len(catalog.list_by_status("built")),
                "refused": len(catalog.list_by_status("refused")),
                "s": round(seconds, 1),
                "times as fast": round(rows[0]["s"] / seconds, 2) if rows else 1.0,
                "second run, s": round(again, 2),
                "built by the second run": len(second.built_now),
            }
        )
    return rows


def measure_rows(folder: Path, count: int) -> Row:
    """List, hash and schedule a catalogue of many tiny files; in a process of its own.

    Args:
        folder: for the files.
        count: of rows.

    Returns:
        Seconds of each part, and the memory of the process.
    """
    folder.mkdir(parents=True)
    for number in range(count):
        (folder / f"{number}.mp4").write_bytes(b"no video %d" % number)
    names = "\n".join(f"{number}.mp4" for number in range(count))
    (folder / "recordings.csv").write_text(f"video\n{names}\n")
    start = time.perf_counter()
    recordings = read_recordings(folder / "recordings.csv")
    inputs, _ = list_all_inputs(recordings, {})
    tasks = make_plan(recordings, inputs, make_address(folder / "maps")).list_ready({}, {})
    listed = time.perf_counter()
    for task in tasks:
        hash_file(Path(task.inputs[0].address))
    hashed = time.perf_counter()
    first: list[float] = []
    catalog = build_catalog(
        recordings,
        folder / "maps",
        cluster=Cluster(workers=2),
        finished=lambda *_: first.append(time.perf_counter()) if not first else None,
    )
    assert len(catalog.list_by_status("refused")) == count
    return {
        "rows": count,
        "listed, s": round(listed - start, 2),
        "hashed, s": round(hashed - listed, 2),
        "scheduled and the first one done, s": round(first[0] - hashed, 2),
        "all done (refused), s": round(time.perf_counter() - hashed, 1),
        "peak memory of the client, MiB": round(measure_peak_megabytes()),
    }


def _time_build(table: Path, output: Path, cluster: Cluster) -> tuple[float, Catalog]:
    start = time.perf_counter()
    catalog = build_catalog(table, output, cluster=cluster)
    return time.perf_counter() - start, catalog


def _film_clip(path: Path, seed: int) -> Path:
    generator = np.random.default_rng(seed)
    coarse = generator.integers(0, 256, (63, 100, 3), np.uint8)
    still = np.kron(coarse, np.ones((8, 8, 1), np.uint8))
    noise = generator.normal(0.0, 12.0, still.shape)
    still = np.clip(still * 0.6 + 50 + noise, 0, 255).astype(np.uint8)
    hover = Hover(count=12, drift=8.0, perspective=1.0)
    traffic = SpriteTracks((), np.empty((0, 2)), np.empty((12, 0, 3)))
    clip = film(still, traffic, hover, height=SIZE[0], width=SIZE[1], generator=generator)
    return write_video(render_frames(clip), path)


def main(
    count: Annotated[int, typer.Option(help="recordings", min=BAD + 1)] = 100,
    rows: Annotated[int, typer.Option(help="rows of the largest table", min=10)] = 10_000,
    json: JsonFile = None,
) -> None:
    """Measure catalogues; print tables and write JSON."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        table = write_recordings(folder / "clips", count)
        scaling = measure_scaling(table, folder)
        losses = measure_losses(table, folder / "losses", folder / "maps_1")
        few = write_recordings(folder / "few", min(count, STORED))
        build_catalog(few, folder / "maps_few", cluster=Cluster(workers=2))
        store = measure_store(few, folder / "maps_few")
        many = [
            run_in_process(measure_rows, folder / f"rows_{number}", number)
            for number in (rows // 10, rows)
        ]
    for part in (scaling, losses, store, many):
        print_rows(part)
    write_rows(
        scaling,
        json,
        command=f"python -m benchmarks.catalog --count {count} --rows {rows}",
        losses=losses,
        store=store,
        rows_of_tables=many,
    )
