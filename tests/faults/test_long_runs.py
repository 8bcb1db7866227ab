"""The measure of memory over long work finds a leak, and none in a short simulation."""

import sys
from pathlib import Path

import pytest

from tests.faults import long_runs

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="memory is measured in /proc")


def test_a_leak_is_found(monkeypatch):
    kept = []
    pages = int(Path("/proc/self/statm").read_text().split()[1])

    def leak(folder, count, sample):
        for index in range(count):
            kept.append(b"x" * (pages * 4096 // 200))
            sample(index + 1)

    monkeypatch.setitem(long_runs.RUNS, "leak", (leak, 100))
    assert long_runs.measure_run("leak")["largest_change_%"] > 100 * long_runs.TOLERANCE


def test_memory_of_a_short_simulation_is_flat():
    row = long_runs.measure_run("simulation, rollouts", 0.01)
    assert abs(row["largest_change_%"]) < 100 * long_runs.TOLERANCE
