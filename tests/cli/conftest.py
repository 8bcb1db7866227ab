import pytest
from PIL import Image

from benchmarks.synthetic.camera import render_frame


@pytest.fixture(scope="session")
def frames_folder(clip, tmp_path_factory):
    folder = tmp_path_factory.mktemp("frames")
    for index in range(6):
        Image.fromarray(render_frame(clip, index)).save(folder / f"{index:02d}.png")
    rows = [(40, 30), (600, 50), (580, 320), (60, 330), (300, 180)]
    lines = [f"p{i},{u},{v},{0.05 * u},{-0.05 * v}" for i, (u, v) in enumerate(rows)]
    (folder / "gcps.csv").write_text("# crs: local\nname,u,v,x,y\n" + "\n".join(lines))
    return folder
