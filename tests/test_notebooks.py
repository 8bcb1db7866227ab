"""Notebooks are short, and are committed without outputs; `make test` runs some of them."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


def test_notebooks_are_short_and_have_no_outputs():
    assert NOTEBOOKS
    for path in NOTEBOOKS:
        cells = json.loads(path.read_text("utf-8"))["cells"]
        code = [cell for cell in cells if cell["cell_type"] == "code"]
        assert len(code) <= 8, path.name
        assert all(cell["outputs"] == [] for cell in code), path.name


@pytest.mark.parametrize(("user", "asked"), [("0", True), ("1000", False)])
def test_jupyterlab_is_started_as_root_too(tmp_path, user, asked):
    if shutil.which("make") is None or sys.platform == "win32":
        pytest.skip("no make, or no user ids")
    (tmp_path / "id").write_text(f"#!/bin/sh\necho {user}\n")
    (tmp_path / "id").chmod(0o755)
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["make", "-n", "notebook", "LAB=--no-browser --port 8888"],
        cwd=NOTEBOOKS[0].parents[1],
        env=dict(os.environ, PATH=path),
        capture_output=True,
        text=True,
        check=True,
    )
    line = next(line for line in done.stdout.splitlines() if "-m jupyterlab" in line)
    assert ("--allow-root" in line) == asked
    assert line.endswith("--no-browser --port 8888")
