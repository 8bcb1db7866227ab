import json

import pytest
from typer.testing import CliRunner

from benchmarks import viewer

pytestmark = pytest.mark.slow


def test_a_small_map_is_timed(chromium, tmp_path, monkeypatch):
    import typer

    monkeypatch.setattr(viewer, "DURATION_S", 5.0)
    monkeypatch.setattr(viewer, "AGENTS", 4)
    monkeypatch.setattr(viewer, "PLAYED_S", 0.5)
    app = typer.Typer()
    app.command()(viewer.main)
    path = tmp_path / "viewer.json"
    result = CliRunner().invoke(app, ["--side", "600", "--repeats", "1", "--json", str(path)])
    assert result.exit_code == 0, result.output
    rows = json.loads(path.read_text())["rows"]
    assert 0 < rows[0]["paint_s"] <= rows[0]["total_s"]
    assert rows[2]["playing_per_s"] > 1
