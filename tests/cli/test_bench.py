import json

import pytest
from typer.testing import CliRunner

from geoaim.cli import app
from geoaim.mapping.registration import own_video

runner = CliRunner()


@pytest.mark.parametrize("flags", [[], ["--quick"]])
def test_a_video_of_ones_own_gives_json_and_markdown(tmp_path, monkeypatch, flags):
    def measure(video, quick, progress):
        progress("rows", 1, 1)
        return [{"video": video, "quick": str(quick), "stated, px": float("nan")}]

    monkeypatch.setattr(own_video, "measure_own_video", measure)
    command = ["bench", "registration", "my.mp4", "-o", str(tmp_path / "new"), *flags]
    result = runner.invoke(app, command)
    assert result.exit_code == 0, result.output
    content = json.loads((tmp_path / "new" / "video.json").read_text("utf-8"))
    assert content["rows"] == [{"video": "my.mp4", "quick": str(bool(flags)), "stated, px": None}]
    assert content["command"] == " ".join(["geoaim bench registration my.mp4", *flags])
    assert (tmp_path / "new" / "video.md").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["registration"], 2, "video"),
        (["registration", "missing.mp4"], 1, "missing.mp4"),
        (["registration", "my.mp4", "-o", "file"], 1, "file"),
        (["decoding", "my.mp4"], 2, "decoding"),
    ],
)
def test_mistakes_are_one_line_and_an_exit_code(tmp_path, monkeypatch, arguments, code, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    result = runner.invoke(app, ["bench", *arguments])
    assert result.exit_code == code
    assert message in result.output
    assert not (tmp_path / "bench").exists()
