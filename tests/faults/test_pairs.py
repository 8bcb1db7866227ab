"""A map never stands beside the picture of another, whenever the writer is interrupted."""

import sys

import pytest

from geoaim.files import atomic_write
from tests.faults import pairs
from tests.faults.interruption import run_interrupted

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes cannot fork")


@pytest.mark.parametrize("how", ["kill", "error"])
def test_interrupted_pair_is_old_or_new_and_never_mixed(tmp_path, how):
    states = set()
    for step in range(1, 20):
        target = tmp_path / str(step) / "map.tif"
        target.parent.mkdir()
        pairs.write_pair(target)
        outcome = run_interrupted(pairs.write_pair, target, step, how=how, preload=pairs.__name__)
        look = target.with_suffix(".png")
        states.add((target.read_text(), look.read_text() if look.exists() else None))
        pairs.write_pair(target)
        assert {path.name for path in target.parent.iterdir()} == {"map.tif", "map.png"}, step
        if outcome.changes < step:  # it was not interrupted any more
            break
    assert outcome.changes < step
    assert {("0", "0"), ("1", "1")} <= states <= {("0", "0"), ("0", None), ("1", None), ("1", "1")}


def test_link_stays_and_the_file_that_it_names_is_replaced(tmp_path):
    file, link = tmp_path / "elsewhere" / "map.tif", tmp_path / "link.tif"
    file.parent.mkdir()
    file.write_text("old")
    link.symlink_to(file)
    with atomic_write(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert file.read_text() == "new"
