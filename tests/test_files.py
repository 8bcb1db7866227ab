import pytest

from geoaim.files import atomic_write


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
