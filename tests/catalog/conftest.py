from itertools import islice

import pytest

pytest.importorskip("distributed", reason="the extra catalog is not installed")

from matplotlib.figure import Figure

from benchmarks.synthetic.camera import render_frames
from geoaim.base.encode import write_video
from geoaim.catalog import pipeline as catalog_pipeline
from geoaim.catalog.building import build_recording
from geoaim.mapping import build_map

PLACES = [(40, 30), (600, 50), (580, 320), (60, 330), (300, 180)]


@pytest.fixture(scope="session")
def clip_file(clip, tmp_path_factory):
    return write_video(
        islice(render_frames(clip), 5), tmp_path_factory.mktemp("clip") / "hover.mp4"
    )


@pytest.fixture
def table(clip_file, tmp_path):
    return write_table(clip_file, tmp_path / "recordings")


def write_table(clip_file, folder):
    """Write a table of a recording that can be built and one that cannot, in a new folder."""
    folder.mkdir()
    (folder / "east.mp4").write_bytes(clip_file.read_bytes())
    (folder / "broken.mp4").write_bytes(b"no video")
    rows = [
        f"p{i},{u},{v},{583200.0 + 0.05 * u},{6062200.0 - 0.05 * v}"
        for i, (u, v) in enumerate(PLACES)
    ]
    (folder / "gcps.csv").write_text("# crs: EPSG:32635\nname,u,v,x,y\n" + "\n".join(rows))
    path = folder / "recordings.csv"
    path.write_text("video,gcps\neast.mp4,gcps.csv\nbroken.mp4,gcps.csv\n")
    return path


@pytest.fixture
def in_process(monkeypatch):
    return build_in_process(monkeypatch)


def build_in_process(monkeypatch):
    """Build without Dask and with empty quick looks, which are quick; list what is built."""
    built: list[str] = []
    monkeypatch.setattr(build_map, "draw_quicklook", lambda aim: Figure(figsize=(1, 1)))

    def run_tasks(tasks, cluster, progress):
        for task in tasks:
            record = build_recording(task)
            built.append(record.name)
            yield record

    monkeypatch.setattr(catalog_pipeline, "run_tasks", run_tasks)
    return built
