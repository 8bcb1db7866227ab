"""The checks forgive a test that fails by chance, say so, and nothing else."""

import subprocess
import sys

import pytest

from tests.second_chance import HEADING
from tests.second_chance import __file__ as SCRIPT

ONCE = """
from pathlib import Path
def test_fails_at_first():
    seen = Path(__file__).with_suffix(".seen")
    first = not seen.exists()
    seen.touch()
    assert not first
"""
TESTS = {
    "right": "def test_passes(): pass",
    "once": ONCE,
    "twice": "def test_fails(): assert False",
    "broken": "import nothing_of_the_kind",
}


def run(folder, *names):
    for name in names:
        (folder / f"test_{name}.py").write_text(TESTS[name])
    (folder / "pytest.ini").write_text("[pytest]\n")
    command = [sys.executable, SCRIPT, "-q", "-n", "1", "."]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "code", "told", "failed"),
    [
        (["right"], 0, False, False),
        (["right", "once"], 0, True, False),
        (["right", "twice"], 1, False, True),
        (["once", "twice"], 1, True, True),
        (["right", "broken"], 1, False, True),
    ],
)
def test_what_fails_once_is_named_and_what_fails_twice_fails(tmp_path, names, code, told, failed):
    done = run(tmp_path, *names)
    assert done.returncode == code, done.stdout + done.stderr
    assert (HEADING in done.stdout) == told
    assert ("Failed twice" in done.stdout) == failed
    if told:
        assert "test_once.py::test_fails_at_first" in done.stdout.split(HEADING)[1]


@pytest.mark.slow
def test_no_test_at_all_fails(tmp_path):
    assert run(tmp_path).returncode != 0
