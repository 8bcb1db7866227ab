import json
import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from benchmarks.__main__ import list_benchmarks
from benchmarks.prediction.__main__ import experiment
from benchmarks.results import Results
from benchmarks.stages import make_main


@pytest.mark.parametrize("flags", [[], ["--quick"]])
def test_a_stage_writes_json_and_markdown(tmp_path, flags):
    def measure(quick, progress):
        progress("rows", 1, 1)
        return Results("Title", {"rows": [{"quick": str(quick)}]})

    app = typer.Typer()
    app.command()(make_main("registration.stability", measure))
    result = CliRunner().invoke(app, ["-o", str(tmp_path / "new"), *flags])
    assert result.exit_code == 0, result.output
    content = json.loads((tmp_path / "new" / "stability.json").read_text("utf-8"))
    assert content["rows"] == [{"quick": str(bool(flags))}]
    assert content["command"] == " ".join(["python -m benchmarks.registration.stability", *flags])
    assert (tmp_path / "new" / "stability.md").exists()


def test_every_benchmark_is_listed_with_what_it_measures():
    listed = list_benchmarks()
    stages = {"registration", "background", "georeference", "alignment", "rendering"}
    stages |= {"simulation", "prediction", "tracking", "catalog", "registration.stability"}
    assert {f"benchmarks.{stage}" for stage in stages} <= set(listed)
    assert all(listed.values())


def test_a_stage_is_a_command():
    command = [sys.executable, "-m", "benchmarks.background", "--help"]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "--quick" in found.stdout


def test_experiments_are_listed_by_their_names():
    app = typer.Typer()
    app.command()(experiment)
    done = CliRunner().invoke(app, ["list"])
    assert done.exit_code == 0
    assert "stanford" in done.output
    assert CliRunner().invoke(app, ["none"]).exit_code == 1
