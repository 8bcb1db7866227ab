import os

import fsspec
import pytest

from benchmarks.catalog.stores import serve_store
from geoaim.base.errors import CatalogError
from geoaim.catalog import Recording, build_catalog, verify_catalog
from geoaim.catalog import pipeline as catalog_pipeline
from geoaim.catalog.building import build_recording
from geoaim.catalog.recordings import list_inputs
from geoaim.catalog.storage import join_address, list_folder, make_address


@pytest.mark.slow
def test_a_catalogue_in_a_failing_and_slow_store_equals_one_on_disk(table, tmp_path, monkeypatch):
    monkeypatch.setattr(
        catalog_pipeline, "run_tasks", lambda tasks, *_: map(build_recording, tasks)
    )
    with serve_store(faults=True) as requests:
        for path in table.parent.iterdir():
            fsspec.filesystem("s3").put_file(str(path), f"recordings/in/{path.name}")
        there = build_catalog("s3://recordings/in/recordings.csv", "s3://recordings/maps")
        again = build_catalog("s3://recordings/in/recordings.csv", "s3://recordings/maps")
        assert verify_catalog("s3://recordings/maps") == []
    here = build_catalog(table, tmp_path / "maps")
    for name, record in here.records.items():
        assert there.records[name].status == record.status
        assert there.records[name].content_hash == record.content_hash
        assert there.records[name].files == record.files
    assert again.built_now == ()
    assert requests["answered"] > 20


def test_addresses():
    assert make_address("s3://bucket/a") == "s3://bucket/a"
    assert join_address("s3://bucket/a/", "b.mp4") == "s3://bucket/a/b.mp4"
    assert join_address("/data", "/other/b.mp4") == "/other/b.mp4"
    assert list_folder("memory://nowhere") == {}
    with pytest.raises(CatalogError, match="nothing://bucket"):
        list_folder("nothing://bucket")


def test_symbolic_links_are_followed(tmp_path):
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    video = tmp_path / "there" / "video.mp4"
    video.write_bytes(b"video")
    try:
        (tmp_path / "here" / "a.mp4").symlink_to(video)
        (tmp_path / "here" / "gone.mp4").symlink_to(tmp_path / "nowhere.mp4")
        (tmp_path / "link").symlink_to(tmp_path / "there")
    except OSError:
        pytest.skip("this system has no symbolic links")
    os.utime(video, (1e9, 1e9))
    files = list_folder(str(tmp_path / "here"))
    assert [(name, file.size, file.stamp) for name, file in files.items()] == [
        ("a.mp4", 5, "1000000000.0")
    ]
    assert list(list_folder(str(tmp_path / "link"))) == ["video.mp4"]
    assert list_inputs(Recording("a", str(tmp_path / "here" / "a.mp4")))[0].size == 5
