"""The commands of `make demo`, as the Makefile has them, on a copy of the samples."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def list_commands():
    """Arguments of its commands, and the files that it says to open."""
    text = (ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    recipe = re.search(r"^demo:.*\n((?:\t.*\n)+)", text, re.MULTILINE)[1]
    values = dict(re.findall(r"^(SAMPLE|POINTS) \?= (\S+)", text, re.MULTILINE))
    for name, value in values.items():
        recipe = recipe.replace(f"$({name})", value)
    lines = [line.strip() for line in recipe.splitlines()]
    named = [
        path for line in lines if "Open" in line or "     demo" in line for path in line.split()
    ]
    return [
        shlex.split(line.removeprefix("$(BIN)/geoaim"))
        for line in lines
        if line.startswith("$(BIN)/geoaim")
    ], [path for path in named if path.startswith("demo/")]


@pytest.mark.slow
def test_the_demo_makes_what_it_names_and_does_not_warn_of_itself(tmp_path):
    shutil.copytree(ROOT / "samples", tmp_path / "samples")
    commands, named = list_commands()
    assert len(commands) == 3
    assert len(named) == 5
    said = ""
    for command in commands:
        run = [sys.executable, "-c", "from geoaim.cli import app; app()", *command]
        done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=False)
        said += done.stdout + done.stderr
        assert done.returncode == 0, said
    assert [path for path in named if not (tmp_path / path).stat().st_size] == []
    assert "Warning" not in said
    assert "collision" not in said
