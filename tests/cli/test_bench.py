import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.hover_videos import film_ground
from benchmarks.synthetic import Hover
from benchmarks.synthetic.scenery.texture import make_natural_noise
from geoaim.base.encode import write_video
from geoaim.cli import app
from geoaim.mapping.registration import own_video

runner = CliRunner()


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("bench") / "my.mp4"
    field = make_natural_noise((270, 480), 1.2, np.random.default_rng(0))
    ground = np.dstack([(110 + 30 * field).clip(0, 255).astype(np.uint8)] * 3)
    clip = film_ground(np.tile(ground, (3, 3, 1)), Hover(count=8, drift=6), seed=0)
    write_video(list(clip), path)
    return path


def test_ones_own_video_gives_a_picture_sentences_and_figures(tmp_path, video):
    command = ["bench", str(video), "-o", str(tmp_path / "new"), "--quick"]
    result = runner.invoke(app, command)
    assert result.exit_code == 0, result.output
    assert "geoaim registers 100 % of the frames" in " ".join(result.output.split())
    content = json.loads((tmp_path / "new" / "video.json").read_text("utf-8"))
    rows = {row["method"]: row for row in content["rows"]}
    assert rows.keys() == {"decoding alone", *own_video.METHODS}
    assert rows["geoaim"]["error, px"] < rows["ORB 2000 + MAGSAC"]["error, px"]
    assert content["command"] == f"geoaim bench {video} --quick"
    assert "video.png" in (tmp_path / "new" / "video.md").read_text("utf-8")
    assert cv2.imread(str(tmp_path / "new" / "video.png")) is not None


def test_loops_give_the_error_of_one_registration():
    noise = np.random.default_rng(0).normal(0, 0.3, (3, 200, 2))
    matrices = np.tile(np.eye(3), (3, 200, 1, 1))
    matrices[..., :2, 2] = noise
    references = [0, 70, 140]
    for row, reference in enumerate(references):
        matrices[row, reference] = np.eye(3)
    # two coordinates; each way to another reference has the error of the direct one, too
    assert own_video.measure_loops(matrices, references, (50, 100)) == pytest.approx(0.42, abs=0.1)
    assert own_video.measure_loops(np.full_like(matrices, np.nan), references, (5, 5)) != 0


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        ([], 2, "VIDEO"),
        (["missing.mp4"], 1, "missing.mp4"),
        (["my.mp4", "-o", "file"], 1, "file"),
        (["registration", "my.mp4"], 2, "my.mp4"),
    ],
)
def test_mistakes_are_one_line_and_an_exit_code(tmp_path, monkeypatch, arguments, code, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    result = runner.invoke(app, ["bench", *arguments])
    assert result.exit_code == code
    assert message in result.output
    assert not (tmp_path / "bench").exists()
