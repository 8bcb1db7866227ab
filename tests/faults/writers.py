"""The commands that write files, on inputs of a few pixels; some steps before writing are replaced.

Each takes the folder of its inputs (see `write_inputs`) and the path to write, without a suffix.
"""

import gc
import shutil
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

import cv2
import numpy as np
import torch
from matplotlib.figure import Figure

from benchmarks.prediction import tables
from benchmarks.prediction.__main__ import experiment
from geoaim import catalog, cli, pipeline
from geoaim.aim import quicklook
from geoaim.aim.aim import AIM
from geoaim.aim.files import read_aim, write_aim
from geoaim.base import encode, raster_files
from geoaim.base.files import write_figure
from geoaim.base.world import LONLAT
from geoaim.catalog import building
from geoaim.catalog import pipeline as cataloguing
from geoaim.catalog.records import LOOK
from geoaim.cli.console import report_errors
from geoaim.imagery.alignment import before_after
from geoaim.imagery.alignment import pipeline as alignment
from geoaim.mapping import build_map, texture
from geoaim.mapping.registration import register
from geoaim.mapping.video import video
from geoaim.prediction import dataset, pictures, predict, report, training
from geoaim.prediction.checkpoints import write_model
from geoaim.prediction.metrics import Metric
from geoaim.simulation import episodes
from geoaim.tracking import pipeline as tracking
from geoaim.tracks.files import write_tracks
from geoaim.tracks.formats import read_tracks
from geoaim.web.picking.session import PickedPoint, PickingTask, change_points, open_session
from tests.aim.test_quicklook import REPORT
from tests.faults import seeds
from tests.prediction.tiny import TINY, drive, hill

cv2.setNumThreads(1)  # threads do not survive a fork
torch.set_num_threads(1)
gc.freeze()  # forks share the memory of what is imported
PRELOADED = encode, raster_files, texture, pictures, predict, report, episodes
STEPS = 2  # of the training
RECORDINGS = ("east", "west")  # of a catalogue


def write_inputs(folder: Path, version: int) -> None:
    """Write inputs, from which each command makes other files in each version."""
    folder.mkdir()
    aim, tracks = seeds.make_aim(), seeds.make_tracks()
    write_aim(replace(aim, image=np.roll(aim.image, version, axis=0)), folder / "aim.tif")
    later = tracks.states + np.array([2.5, 0, 0, 0])
    states = np.concatenate([tracks.states, later], axis=1) + version / 8
    present = np.ones(states.shape[:2], bool)
    tracks = replace(tracks, times=np.arange(10) / 10, states=states, present=present)
    write_tracks(tracks, folder / "tracks.csv")
    text = seeds.TABLES["map.osm"].replace("28.29005", f"28.2900{5 + version}")
    (folder / "map.osm").write_text(text)
    (folder / "version").write_text(str(version))
    for name in RECORDINGS:
        (folder / f"{name}.mp4").write_bytes(name.encode())
    write_model(training.init_model(TINY, seed=version), folder / "model.pt")


def build(inputs: Path, target: Path) -> None:
    with (
        patch.object(build_map, "build_aim", lambda *_, **__: read_aim(inputs / "aim.tif")),
        patch.object(build_map, "open_video"),
        patch.object(build_map, "override_telemetry"),
        patch.object(build_map, "draw_quicklook", lambda _: _draw_small_figure(inputs)),
    ):
        cli.build("video.mp4", target.with_suffix(".tif"))


def align(inputs: Path, target: Path) -> None:
    with patch.object(alignment, "align_tiles", lambda *_, **__: read_aim(inputs / "aim.tif")):
        cli.align([str(inputs / "aim.tif")], target.with_suffix(".tif"))


def draw(inputs: Path, target: Path) -> None:
    aim = inputs / "aim.tif"
    cli.draw(inputs / "map.osm", target.with_suffix(".tif"), resolution=0.5, aim=aim)


def export_texture(inputs: Path, target: Path) -> None:
    cli.texture(inputs / "aim.tif", target.parent, resolution=1 + _read_version(inputs))


def register_frames(inputs: Path, target: Path) -> None:
    matrices, ones = np.eye(3)[None] + _read_version(inputs), np.ones(1)
    reference = register.Reference(None, 0, 0.0, "affine", None, 48, 64)
    frames = register.Registration(
        matrices, np.zeros(1, int), np.zeros(1), ("",), ones, ones, ones, reference
    )
    with patch.object(register, "register", lambda *_, **__: frames):
        cli.register("video.mp4", target)


def track(inputs: Path, target: Path) -> None:
    tracks = read_tracks(inputs / "tracks.csv")
    with (
        patch.object(video, "open_video"),
        patch.object(tracking, "track_video", lambda *_, **__: tracks),
    ):
        cli.track("video.mp4", inputs / "aim.tif", target)


def pick(inputs: Path, target: Path) -> None:
    """Replace the points of a page by others."""
    frame = np.zeros((9, 9, 3), np.uint8)
    session = open_session(PickingTask(frame, crs=LONLAT, path=target))
    north = 57.8 + 1e-3 * _read_version(inputs)
    points = [PickedPoint(k, f"p{k}", (k, 2.0 * k), (28.3 + 1e-4 * k, north)) for k in (1, 2)]
    with report_errors():
        change_points(session, points)


def place(inputs: Path, target: Path) -> None:
    aim, tracks = read_aim(inputs / "aim.tif"), read_tracks(inputs / "tracks.csv")
    with (
        patch.object(pipeline, "open_video"),
        patch.object(pipeline, "_check"),
        patch.object(pipeline, "_build", lambda *_: aim),
        patch.object(pipeline, "_track", lambda *_: (SimpleNamespace(tracks=tracks), "")),
        patch.object(pipeline, "_judge", lambda placed, *_: placed),
        patch.object(pipeline, "_film", lambda *given: given[3].write_bytes(b"film")),
        patch.object(pipeline, "draw_quicklook", lambda _: _draw_small_figure(inputs)),
    ):
        pipeline.place_video("video.mp4", target)


def catalogue(inputs: Path, target: Path) -> None:
    """Build two recordings one after the other, at a clock that stands."""

    def copy_map(_: object, path: Path, **__: object) -> AIM:
        shutil.copyfile(inputs / "aim.tif", path)
        write_figure(_draw_small_figure(inputs), path.with_name(LOOK))
        return replace(read_aim(path), report=REPORT)

    clock = SimpleNamespace(perf_counter=float, process_time=float)
    today = SimpleNamespace(now=lambda zone: datetime(2026, 1, 1, tzinfo=UTC))
    build = building.build_recording
    with (
        patch.object(building, "build_map", copy_map),
        patch.object(building, "open_video"),
        patch.object(building, "find_datetime", lambda *_: ("2026-01-01T00:00:00+00:00", "table")),
        patch.object(building, "time", clock),
        patch.object(building, "datetime", today),
        patch.object(cataloguing, "run_tasks", lambda tasks, *_: map(build, tasks)),
    ):
        rows = [catalog.Recording(name, str(inputs / f"{name}.mp4")) for name in RECORDINGS]
        catalog.build_catalog(rows, target.parent)


def render(inputs: Path, target: Path) -> None:
    files = {"tracks": inputs / "tracks.csv", "output": target}
    cli.render(inputs / "aim.tif", "1", **files, size=32, extent=16)


def simulate(inputs: Path, target: Path) -> None:
    cli.simulate(inputs / "aim.tif", target, inputs / "tracks.csv", duration=0.8)


def convert(inputs: Path, target: Path) -> None:
    cli.convert([inputs / "tracks.csv"], target)


def film_simulation(inputs: Path, target: Path) -> None:
    files = inputs / "aim.tif", target, inputs / "tracks.csv"
    with patch.dict(sys.modules["geoaim.cli.simulate"].VIDEO, size=32):
        cli.simulate(*files, ego="1", duration=0.8, film=target.parent / "films" / "out.mp4")


def predict_agents(inputs: Path, target: Path) -> None:
    files = inputs / "aim.tif", target, inputs / "tracks.csv"
    cli.predict(*files, weights=inputs / "model.pt", duration=0.2, samples=2)


def train(inputs: Path, target: Path) -> None:
    """Train with a checkpoint after each step, and a clock by which all steps take as long."""
    config = training.TrainConfig(
        steps=STEPS, batch_size=2, history=(2, 4), mirror=True, checkpoint_interval=1
    )
    segments = dataset.Dataset(drive(10, 3), drive(10, 1, curve=-0.05), hill())
    clock = SimpleNamespace(perf_counter=count().__next__)
    with ExitStack() as stack:
        for owner, name, value in (
            (dataset, "make_dataset", lambda *_, **__: segments),
            ("geoaim.prediction.config", "configure_fine_tuning", lambda *_, **__: config),
            (sys.modules["geoaim.cli.train"], "CHECKPOINT_STEPS", 1),
            (training, "time", clock),
        ):
            owner = sys.modules[owner] if isinstance(owner, str) else owner
            stack.enter_context(patch.object(owner, name, value))
        files = {"tracks": inputs / "tracks.csv", "weights": inputs / "model.pt"}
        cli.train(inputs / "aim.tif", output=target.parent, **files)


def repeat_experiment(inputs: Path, target: Path) -> None:
    metrics = {"minADE": Metric(np.array([1.0 + _read_version(inputs)]), np.ones(1))}
    models = [SimpleNamespace(sample=None)]
    with (
        patch.object(tables, "make_places", lambda *_, **__: [inputs]),
        patch.object(tables, "train_all_seeds", lambda *_: models),
        patch.object(tables, "evaluate_case", lambda *_: metrics),
        patch.object(tables, "draw_futures_on_maps", lambda *_: _draw_small_figure(inputs)),
    ):
        experiment("pedestrians", inputs, target.parent)


def write(name: str, inputs: Path, target: Path) -> None:
    """Run a command of `WRITERS`; its pictures of maps are replaced by small ones."""
    command, suffix = WRITERS[name]
    figure = _draw_small_figure(inputs)
    with (
        patch.object(quicklook, "draw_quicklook", lambda *_, **__: figure),
        patch.object(before_after, "draw_alignment", lambda *_, **__: figure),
        patch.object(pictures, "draw_futures", lambda _: figure),
        patch.object(report, "plot_training", lambda _, path: write_figure(figure, path)),
    ):
        command(inputs, target.with_suffix(suffix))


def _draw_small_figure(inputs: Path) -> Figure:
    return Figure(figsize=(0.2 + _read_version(inputs) / 10, 0.2))


def _read_version(inputs: Path) -> int:
    return int((inputs / "version").read_text())


WRITERS: dict[str, tuple[Callable[[Path, Path], None], str]] = {
    "build": (build, ".tif"),
    "align": (align, ".tif"),
    "draw": (draw, ".tif"),
    "texture": (export_texture, ".json"),
    "register": (register_frames, ".csv"),
    "register, Parquet": (register_frames, ".parquet"),
    "render, picture": (render, ".png"),
    "render, animation": (render, ".gif"),
    "render, video": (render, ".mp4"),
    "track": (track, ".csv"),
    "pick": (pick, ".csv"),
    "convert": (convert, ".gpkg"),
    "simulate": (simulate, ".csv"),
    "simulate, Parquet": (simulate, ".parquet"),
    "simulate, video": (film_simulation, ".csv"),
    "predict": (predict_agents, ".csv"),
    "predict, picture": (predict_agents, ".png"),
    "experiment": (repeat_experiment, ".json"),
    "train": (train, ".pt"),
    "catalog": (catalogue, ".csv"),
}
