import json

import pytest
from typer.testing import CliRunner

from benchmarks import stages as benchmarks
from geoaim.cli import app
from geoaim.mapping.bench.report import Results

runner = CliRunner()


@pytest.fixture(autouse=True)
def one_row(monkeypatch):
    """Benchmarks that measure nothing and say whether they were quick."""

    def measure(quick, progress):
        progress("rows", 1, 1)
        return Results("Title", {"rows": [{"quick": str(quick)}]})

    monkeypatch.setattr(benchmarks, "BENCHMARKS", dict.fromkeys(benchmarks.BENCHMARKS, measure))


@pytest.mark.parametrize("stage", benchmarks.BENCHMARKS)
@pytest.mark.parametrize("flags", [[], ["--quick"]])
def test_each_stage_writes_json_and_markdown(tmp_path, stage, flags):
    result = runner.invoke(app, ["bench", stage, "-o", str(tmp_path / "new"), *flags])
    assert result.exit_code == 0, result.output
    content = json.loads((tmp_path / "new" / f"{stage}.json").read_text("utf-8"))
    assert content["rows"] == [{"quick": str(bool(flags))}]
    assert content["command"] == " ".join(["geoaim bench", stage, *flags])
    assert (tmp_path / "new" / f"{stage}.md").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["georeference", "my.mp4"], 1, "registration is"),
        (["registration", "missing.mp4"], 1, "missing.mp4"),
        (["registration", "-o", "file"], 1, "file"),
        (["decoding"], 2, "decoding"),
    ],
)
def test_mistakes_are_one_line_and_an_exit_code(tmp_path, monkeypatch, arguments, code, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    result = runner.invoke(app, ["bench", *arguments])
    assert result.exit_code == code
    assert message in result.output
    assert not (tmp_path / "bench").exists()
