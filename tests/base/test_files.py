import errno
import os
import sys

import pytest

from geoaim.base.files import (
    TEMPORARY,
    atomic_files,
    atomic_folder,
    atomic_write,
    keep_files_of_others,
)


def test_a_complete_block_replaces_the_file(tmp_path):
    path = tmp_path / "new" / "a.txt"
    for text in ("old", "new"):
        with atomic_write(path) as temporary:
            temporary.write_text(text)
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


def test_a_failed_block_leaves_the_old_file_and_no_temporary_files(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(FileNotFoundError), atomic_write(path):
        (tmp_path / "missing.txt").read_text()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_complete_block_makes_the_folder_and_nothing_else(tmp_path):
    with atomic_folder(tmp_path / "new" / "folder") as temporary:
        (temporary / "a.txt").write_text("a")
        assert not (tmp_path / "new" / "folder").exists()
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a.txt", "folder", "new"]


def test_a_failed_block_makes_no_folder(tmp_path):
    with pytest.raises(FileNotFoundError), atomic_folder(tmp_path / "folder") as temporary:
        (temporary / "missing.txt").read_text()
    assert list(tmp_path.iterdir()) == []


def test_folder_that_holds_files_is_refused_before_and_after_the_block(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with (
        pytest.raises(ValueError, match=r"holds a\.txt; name a new folder"),
        atomic_folder(tmp_path),
    ):
        pytest.fail("the block ran")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"holds b\.txt"), atomic_folder(tmp_path / "empty"):
        (tmp_path / "empty" / "b.txt").write_text("of another run")
    assert (tmp_path / "empty" / "b.txt").read_text() == "of another run"


def test_working_folder_and_a_file_are_refused(tmp_path, monkeypatch):
    (tmp_path / "a.txt").write_text("old")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for folder, reason in ((".", "name a new folder in it"), ("../a.txt", "is a file")):
        with pytest.raises(ValueError, match=reason), atomic_folder(folder):
            pytest.fail("the block ran")


def test_the_folder_that_a_link_leads_to_is_written(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    with atomic_folder(tmp_path / "link") as temporary:
        (temporary / "a.txt").write_text("a")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "elsewhere" / "a.txt").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="folders cannot be locked")
def test_leftovers_are_removed_and_folders_in_use_are_not(tmp_path):
    leftover = tmp_path / f"{TEMPORARY}{'0' * 32}"
    leftover.mkdir()
    (leftover / "a.txt").write_text("half")
    by_hand = tmp_path / f"{TEMPORARY}notes"
    by_hand.mkdir()
    with atomic_write(tmp_path / "a.txt") as first, atomic_write(tmp_path / "b.txt") as second:
        assert not leftover.exists()
        first.write_text("a")
        second.write_text("b")
    assert sorted(path.name for path in tmp_path.iterdir()) == [by_hand.name, "a.txt", "b.txt"]


def test_link_stays_and_the_file_that_it_names_is_replaced(tmp_path):
    file, link = tmp_path / "elsewhere" / "map.tif", tmp_path / "link.tif"
    file.parent.mkdir()
    file.write_text("old")
    link.symlink_to(file)
    with atomic_write(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert file.read_text() == "new"


@pytest.mark.skipif(sys.platform == "win32", reason="permissions and pipes of POSIX")
def test_permissions_stay_and_a_pipe_is_not_replaced(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    path.chmod(0o600)
    with atomic_write(path) as temporary:
        temporary.write_text("new")
    assert path.stat().st_mode & 0o777 == 0o600
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match="no ordinary file"), atomic_write(tmp_path / "pipe"):
        pytest.fail("the block ran")
    assert (tmp_path / "pipe").is_fifo()


def write_map(folder, text, meanwhile=None):
    paths = folder / "map.tif", folder / "map.png"
    with atomic_files(*paths) as parts:
        for part in parts:
            part.write_text(text)
        if meanwhile is not None:
            paths[1].write_text(meanwhile)


def test_what_another_program_writes_during_a_command_is_kept(tmp_path):
    write_map(tmp_path, "old")
    with keep_files_of_others():
        write_map(tmp_path, "first")
        write_map(tmp_path, "second")
    taken = r"map\.png was written .*map-2\.tif and .*map-2\.png"
    with keep_files_of_others(), pytest.raises(FileExistsError, match=taken):
        write_map(tmp_path, "third", meanwhile="theirs")
    found = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert found.pop("map.png") == "theirs"
    assert found == {"map.tif": "second", "map-2.tif": "third", "map-2.png": "third"}


def test_a_command_replaces_its_own_file_by_any_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with keep_files_of_others():
        for path in ("a.txt", tmp_path / "a.txt"):
            with atomic_write(path) as part:
                part.write_text(str(path))
    assert (tmp_path / "a.txt").read_text() == str(tmp_path / "a.txt")


def test_what_several_programs_write_is_replaced(tmp_path):
    with keep_files_of_others(), atomic_write(tmp_path / "tile.png", shared=True) as part:
        part.write_text("ours")
        (tmp_path / "tile.png").write_text("theirs")
    assert (tmp_path / "tile.png").read_text() == "ours"


def test_a_full_disk_names_what_was_written(tmp_path):
    def fail():
        raise OSError(errno.ENOSPC, "No space left on device")

    for write in (atomic_write, atomic_folder):
        with (
            pytest.raises(OSError, match=r"No space left on device: '.*new'"),
            write(tmp_path / "new"),
        ):
            fail()
    assert list(tmp_path.iterdir()) == []
