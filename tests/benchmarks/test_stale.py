"""Published results say what made them, and are stale when their stage has changed since."""

from pathlib import Path

import pytest

from benchmarks import results, stale
from benchmarks.results import run_git, write_json

KNOWN = {"command": "python -m benchmarks.georeference", "commit": "HEAD", "date": "2026-11-28"}


def test_results_state_commit_date_and_command(tmp_path: Path) -> None:
    path = tmp_path / "one.json"
    write_json({"command": "python -m benchmarks.rendering", "rows": []}, path)
    text = path.read_text("utf-8")
    for key in ("command", "commit", "date"):
        assert f'"{key}"' in text


@pytest.mark.parametrize("key", ["command", "commit", "date"])
def test_a_result_that_does_not_state_its_origin_is_stale(key: str) -> None:
    assert stale.explain_staleness({**KNOWN, key: ""}) == f"states no {key}"


def test_a_result_of_an_unknown_command_or_of_uncommitted_code_is_stale() -> None:
    assert "does not know" in stale.explain_staleness({**KNOWN, "command": "geoaim bench"})
    assert "not committed" in stale.explain_staleness({**KNOWN, "uncommitted": True})


def test_a_result_is_stale_when_code_of_its_stage_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = tmp_path / "geoaim/mapping/georeference/fit.py"
    module.parent.mkdir(parents=True)
    module.write_text("def fit(n):\n    if n < 0:\n        raise ValueError('below 0')\n")
    for owner in (stale, results):
        monkeypatch.setattr(owner, "ROOT", tmp_path)
    run_git("init", "--quiet")
    run_git("add", ".")
    run_git("-c", "user.name=a", "-c", "user.email=a@b.c", "commit", "--quiet", "-m", "one")
    assert stale.explain_staleness(KNOWN) == ""
    same = '"""Fit."""\ndef fit(n: int) -> None:\n  if n < 0:  # few\n    raise ValueError("few")\n'
    module.with_name("moved.py").write_text(same)
    module.write_text("import sys\n")
    assert stale.explain_staleness(KNOWN) == ""
    module.write_text(same.replace("n < 0", "n < 1"))
    assert stale.explain_staleness(KNOWN) == "geoaim/mapping/georeference changed since HEAD"
