"""Each command leaves old files or new ones, whole and together, whenever it is interrupted."""

import shutil
import sys
from random import Random

import pytest

from geoaim.prediction.checkpoints import read_state
from tests.faults import writers
from tests.faults.interruption import KILLED, How, Outcome, run_interrupted
from tests.faults.kills import RESUMED, count_kills, make_case, read_after_next_run, read_files

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="processes cannot fork"),
]
KILLS = 4  # of each command; docs/bench/kills.json counts 50
EXIT_CODES: dict[How, set[int]] = {
    "kill": {KILLED},
    "error": {0, 1},  # 0: the unfinished files are not removed
    "stop": {130},
    "stop again": {130},
    "full": {1},
}


@pytest.fixture(scope="module", params=[name for name in writers.WRITERS if name not in RESUMED])
def case(request, tmp_path_factory):
    return make_case(request.param, tmp_path_factory.mktemp("case"))


@pytest.fixture(scope="module")
def training(tmp_path_factory):
    return make_case("train", tmp_path_factory.mktemp("training"))


def check_outcome(outcome: Outcome, how: How) -> None:
    """Check the exit code, and that an error is one line."""
    assert outcome.exit_code in EXIT_CODES[how], outcome.printed
    assert "Traceback" not in outcome.printed
    assert outcome.printed.count("Error: ") == (outcome.exit_code == 1), outcome.printed


@pytest.mark.parametrize("hows", [("kill",), ("error", "stop", "stop again")], ids=" ".join)
def test_interrupted_command_leaves_old_or_new_files(case, tmp_path, hows):
    old, suffix = read_files(case.old), writers.WRITERS[case.name][1]
    for step in range(1, case.changes + 1):
        folder, how = tmp_path / str(step), hows[step % len(hows)]
        shutil.copytree(case.old, folder)
        check_outcome(run_interrupted(case.write, folder / "out", step, how=how), how)
        left = read_after_next_run(folder)
        assert left.items() <= old.items() or left.items() <= case.new.items(), step
        # a picture may be missing; that of a texture says that its JSON was read
        assert any(name.endswith((suffix, "texture.png")) for name in left), step


def test_command_killed_at_random_moments_leaves_old_or_new_files(case, tmp_path):
    counts = count_kills(case, KILLS, tmp_path, Random(case.name))
    assert [counts[name] for name in ("broken", "leftovers", "errors")] == [0, 0, 0], counts


def test_full_disk_leaves_the_old_files_and_ends_in_a_line(case, tmp_path):
    size = max(map(len, case.new.values()))
    for limit in (0, size // 2, size - 1):
        folder = tmp_path / str(limit)
        shutil.copytree(case.old, folder)
        check_outcome(run_interrupted(case.write, folder / "out", limit, how="full"), "full")
        assert read_after_next_run(folder) == read_files(case.old), limit


def test_interrupted_training_ends_the_same_when_it_is_called_again(training, tmp_path):
    case, seen = training, []
    for step in range(1, case.changes + 1):
        target = tmp_path / "folders" / str(step) / "out"
        target.parent.mkdir(parents=True)
        run_interrupted(case.write, target, step, how="kill")
        checkpoint, log = target.with_name("checkpoint.pt"), target.with_name("log.csv")
        if log.exists():
            rows = len(log.read_text().splitlines()) - 1
            assert rows == len(read_state(checkpoint)["log"]), step
        if (left := read_after_next_run(target.parent)) in seen:
            continue
        seen.append(left)
        outcome = run_interrupted(case.write, target, None, how="kill")
        assert outcome.exit_code == 0, outcome.printed
        assert read_files(target.parent) == case.new, step


@pytest.mark.parametrize("name", ["catalog", "place"])
def test_killed_folders_are_absent_or_whole_and_a_catalogue_goes_on(name, tmp_path):
    (tmp_path / "case").mkdir()
    (tmp_path / "kills").mkdir()
    counts = count_kills(
        make_case(name, tmp_path / "case"), KILLS, tmp_path / "kills", Random(name)
    )
    assert [counts[name] for name in ("broken", "leftovers", "errors")] == [0, 0, 0], counts


def test_stopped_training_says_what_is_kept(training, tmp_path):
    for step, kept in ((3, "no checkpoint yet"), (24, "goes on after step 1")):
        (tmp_path / str(step)).mkdir()
        outcome = run_interrupted(training.write, tmp_path / str(step) / "out", step, how="stop")
        assert outcome.exit_code == 130
        assert kept in " ".join(outcome.printed.split())


def test_training_on_a_full_disk_ends_in_a_line(training, tmp_path):
    size = max(map(len, training.new.values()))
    for limit in (0, size // 2, size - 1):
        folder = tmp_path / str(limit)
        folder.mkdir()
        check_outcome(run_interrupted(training.write, folder / "out", limit, how="full"), "full")
        if kept := read_after_next_run(folder):  # the first checkpoint is smaller than the last
            assert limit == size - 1
            assert set(kept) == {"checkpoint.pt", "log.csv"}
            assert len(read_state(folder / "checkpoint.pt")["log"]) == 1


def test_training_from_a_damaged_checkpoint_ends_in_a_line_and_replaces_nothing(training, tmp_path):
    whole = training.new["checkpoint.pt"]
    middle, last = len(whole) // 2, len(whole) - 1
    changed = [whole[:k] + bytes([whole[k] ^ 4]) + whole[k + 1 :] for k in (0, middle, last)]
    for content in (b"", whole[:middle], *changed):
        (tmp_path / "checkpoint.pt").write_bytes(content)
        check_outcome(run_interrupted(training.write, tmp_path / "out", None, how="error"), "full")
        assert read_files(tmp_path) == {"checkpoint.pt": content}
