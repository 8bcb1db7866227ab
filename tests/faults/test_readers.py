"""Mutated files are read, or refused by an error of geoaim: in time, and within memory."""

import json
import subprocess
import sys

import pytest

from tests.faults.readers import READERS

MUTATIONS = 40  # docs/bench/faults.json: 10,000

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="memory is measured in /proc"),
]


@pytest.fixture(scope="module")
def results(request, tmp_path_factory):
    """Outcomes of the mutations of the chosen readers, by a process that forks."""
    here = [item for item in request.session.items if item.path == request.path]
    names = dict.fromkeys(item.callspec.params["reader"] for item in here)
    chosen = [argument for name in names for argument in ("--reader", name)]
    path = tmp_path_factory.mktemp("faults") / "faults.json"
    command = [
        sys.executable,
        "-m",
        "tests.faults.run",
        "--count",
        str(MUTATIONS),
        "-o",
        str(path),
        *chosen,
    ]
    subprocess.run(command, stdout=subprocess.DEVNULL, check=False)
    return json.loads(path.read_text())


@pytest.mark.parametrize("reader", READERS)
def test_mutated_file_is_read_or_refused(results, reader):
    assert [fault for fault in results["faults"] if fault["reader"] == reader] == []
    (counts,) = [row for row in results["rows"] if row["reader"] == reader]
    assert counts["read"] + counts["refused"] == MUTATIONS
