"""A sample is there as a whole or not at all, whenever its writer is interrupted."""

import shutil
import sys
from pathlib import Path

import pytest

from tests.faults import small_sample
from tests.faults.interruption import KILLED, How, Outcome, run_interrupted
from tests.faults.kills import read_files, write_next

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="processes cannot fork"),
]


def interrupt_sample(target: Path, step: int | None = None, how: How = "kill") -> Outcome:
    return run_interrupted(small_sample.write_small_sample, target, step, how=how)


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """The files of a sample that is not interrupted, and how many changes they took."""
    folder = tmp_path_factory.mktemp("complete") / "sample"
    outcome = interrupt_sample(folder)
    assert outcome.exit_code == 0
    assert outcome.changes > 20
    return read_files(folder), outcome.changes


@pytest.mark.parametrize("how", ["kill", "error"])
def test_interrupted_sample_is_absent_or_whole(complete, tmp_path, how):
    files, changes = complete
    for step in range(1, changes + 2):  # one more: an empty folder takes a change more
        target = tmp_path / str(step) / "sample"
        (target if step % 2 else target.parent).mkdir(parents=True)
        interrupt_sample(target, step, how)
        written = read_files(target)  # empty where there is no folder
        assert not written or written.keys() == files.keys(), step
        assert [name for name in written if written[name] != files[name]] == [], step
        write_next(target.parent)
        assert {path.name for path in target.parent.iterdir()} <= {"sample", "next.txt"}, step


def test_leftovers_are_removed_although_their_removal_is_interrupted(complete, tmp_path):
    _, changes = complete
    for step in (changes - 1, 1, 2, 3):
        assert interrupt_sample(tmp_path / "sample", step).exit_code == KILLED
    write_next(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["next.txt"]


@pytest.mark.parametrize("how", ["kill", "error"])
def test_interrupted_sample_leaves_an_older_one_and_files_made_by_hand(complete, tmp_path, how):
    target = tmp_path / "sample"
    interrupt_sample(target)
    for name in ("tracks_annotated_by_hand.csv", "19/mine.txt"):
        (target / name).write_text("a week of work")
    before = read_files(target)
    for step in (1, 2, 3, None):
        assert interrupt_sample(target, step, how).exit_code in (KILLED, 1)
        assert read_files(target) == before, step


def test_second_of_two_runs_at_once_is_refused_and_mixes_nothing(complete, tmp_path, monkeypatch):
    target = tmp_path / "sample"

    def write_other_meanwhile(*arguments) -> None:
        monkeypatch.undo()
        assert interrupt_sample(target).exit_code == 0
        shutil.copyfile(*arguments)

    monkeypatch.setattr(small_sample.command.shutil, "copyfile", write_other_meanwhile)
    with pytest.raises(ValueError, match="name a new folder"):
        small_sample.write_small_sample(target)
    assert read_files(target) == complete[0]
    assert [path.name for path in tmp_path.iterdir()] == ["sample"]
