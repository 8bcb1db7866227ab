from itertools import islice

import pytest

pytest.importorskip("distributed", reason="the extra catalog is not installed")

from benchmarks.synthetic.camera import render_frames
from geoaim.base.encode import write_video

PLACES = [(40, 30), (600, 50), (580, 320), (60, 330), (300, 180)]


@pytest.fixture(scope="session")
def clip_file(clip, tmp_path_factory):
    return write_video(
        islice(render_frames(clip), 5), tmp_path_factory.mktemp("clip") / "hover.mp4"
    )


@pytest.fixture
def table(clip_file, tmp_path):
    """A table of a recording that can be built and one that cannot, in a folder of its own."""
    folder = tmp_path / "recordings"
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
