import errno
import json

import av
import pystac
import pytest
from distributed import LocalCluster
from rasterio._err import CPLE_OutOfMemoryError
from rasterio.errors import RasterioIOError
from typer.testing import CliRunner

from geoaim.base.errors import (
    AimError,
    BackgroundError,
    CatalogError,
    GeoaimWarning,
    GeoreferenceError,
    VideoError,
)
from geoaim.catalog import (
    Cluster,
    build_catalog,
    building,
    engine,
    read_catalog,
    read_recordings,
    verify_catalog,
)
from geoaim.catalog import pipeline as catalog_pipeline
from geoaim.catalog.building import build_recording, make_record, make_task
from geoaim.catalog.recordings import Recording, list_inputs
from geoaim.catalog.records import write_record
from geoaim.catalog.report import format_page
from geoaim.cli import app
from geoaim.mapping import build_map

run = CliRunner().invoke


def test_a_catalogue_has_maps_items_an_index_and_a_report(table, tmp_path, in_process):
    catalog = build_catalog(table, tmp_path / "maps")
    status = {name: record.status for name, record in catalog.records.items()}
    assert status == {"broken": "refused", "east": "built"}
    assert "not a video" in catalog.records["broken"].reason
    assert verify_catalog(tmp_path / "maps") == []
    item = pystac.Item.from_file(tmp_path / "maps/recordings/east/item.json")
    item.stac_extensions = []  # their schemas are on the web, that of items is in pystac
    item.validate()
    assert item.bbox == pytest.approx([28.29, 54.70, 28.29, 54.70], abs=0.01)
    assert item.properties["gsd"] == pytest.approx(0.05, rel=1e-3)
    built = [catalog.records["east"]]
    assert format_page(built) == format_page(built)  # nor do its pictures differ
    collection = pystac.Collection.from_file(tmp_path / "maps/collection.json")
    assert [item.id for item in collection.get_items()] == ["east"]
    from pyarrow.parquet import read_table
    from stac_geoparquet.arrow import stac_table_to_items

    rows = list(stac_table_to_items(read_table(tmp_path / "maps/items.parquet")))
    assert rows[0]["assets"]["aim"]["href"] == "./recordings/east/aim.tif"
    report = json.loads((tmp_path / "maps/report.json").read_text())
    assert report["counts"] == {"refused": 1, "built": 1}
    page = (tmp_path / "maps/report.html").read_text()
    assert all(text in page for text in ("<svg", "not a video", "recordings/east/aim.png"))


@pytest.mark.slow
def test_maps_are_byte_for_byte_those_of_geoaim_build(table, tmp_path, in_process):
    build_catalog(table, tmp_path / "maps")
    output = tmp_path / "alone" / "map.tif"
    build_map.build_map(table.parent / "east.mp4", output, gcps=table.parent / "gcps.csv")
    for mine, theirs in (("map.tif", "aim.tif"), ("map.png", "aim.png")):
        there = tmp_path / "maps/recordings/east" / theirs
        assert (tmp_path / "alone" / mine).read_bytes() == there.read_bytes()


def test_only_what_is_new_or_changed_is_built_again(table, tmp_path, in_process):
    catalog = tmp_path / "maps"
    build_catalog(table, catalog)
    assert sorted(in_process) == ["broken", "east"]
    assert build_catalog(table, catalog).built_now == ()
    (catalog / "recordings/east/aim.png").unlink()
    assert build_catalog(table, catalog).built_now == ("east",)
    table.write_text(table.read_text().replace("broken.mp4,", "nowhere.mp4,"))
    assert build_catalog(table, catalog).built_now == ("nowhere",)
    assert build_catalog(table, catalog).built_now == ()
    points = table.parent / "gcps.csv"
    points.write_text(points.read_text() + "\n")
    assert build_catalog(table, catalog).built_now == ("east",)


def test_a_file_that_was_only_touched_is_read_and_not_built(table, tmp_path, in_process):
    catalog = build_catalog(table, tmp_path / "maps")
    map_file = tmp_path / "maps/recordings/east/aim.tif"
    written = map_file.stat().st_mtime_ns
    for video in table.parent.glob("*.mp4"):
        video.write_bytes(video.read_bytes())
    again = build_catalog(table, tmp_path / "maps")
    assert map_file.stat().st_mtime_ns == written
    assert again.records["east"].started == catalog.records["east"].started
    assert build_catalog(table, tmp_path / "maps").built_now == ()


@pytest.mark.slow
def test_telemetry_beside_a_video_belongs_to_its_inputs(table, tmp_path, in_process):
    build_catalog(table, tmp_path / "maps")
    (table.parent / "east.SRT").write_text("no telemetry")
    assert build_catalog(table, tmp_path / "maps").built_now == ("east",)


@pytest.mark.slow
def test_verify_finds_what_is_missing_changed_or_foreign(table, tmp_path, in_process):
    catalog = tmp_path / "maps"
    build_catalog(table, catalog)
    east = catalog / "recordings/east"
    content = bytearray((east / "aim.tif").read_bytes())
    content[-1] ^= 1
    (east / "aim.tif").write_bytes(content)
    (east / "aim.png").write_bytes(b"short")
    (east / "item.json").unlink()
    (east / "notes.txt").write_text("mine")
    (catalog / "report.html").unlink()
    found = {problem.path: problem.found for problem in verify_catalog(catalog)}
    assert found["recordings/east/aim.tif"] == "changed: its checksum is another one"
    assert found["recordings/east/aim.png"].startswith("changed: 5 bytes")
    assert found["recordings/east/item.json"] == "missing"
    assert found["recordings/east/notes.txt"] == "belongs to no map that was built"
    assert found["report.html"] == "missing"
    assert len(found) == 5
    result = run(app, ["catalog", "verify", str(catalog)])
    assert result.exit_code == 1
    assert "its checksum is another one" in result.output


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["emptied", "altered", "removed"])
def test_every_damaged_file_is_found_and_made_again(table, tmp_path, in_process, damage):
    table.write_text("video,gcps\neast.mp4,gcps.csv\n")
    catalog = tmp_path / "maps"
    build_catalog(table, catalog)
    files = {path.relative_to(catalog).as_posix(): path for path in catalog.rglob("*.*")}
    assert len(files) == 9
    del files["recordings/east/record.json"]  # see below
    for path in files.values():
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content if damage == "altered" else b"")
        if damage == "removed":
            path.unlink()
    assert {problem.path for problem in verify_catalog(catalog)} == set(files)
    if damage != "removed":
        assert run(app, ["catalog", "verify", str(catalog), "--repair"]).exit_code == 1
    build_catalog(table, catalog)
    assert verify_catalog(catalog) == []


@pytest.mark.slow
def test_an_altered_record_is_found_and_built_again(table, tmp_path, in_process):
    table.write_text("video,gcps\nbroken.mp4,gcps.csv\n")
    build_catalog(table, tmp_path / "maps")
    path = tmp_path / "maps/recordings/broken/record.json"
    path.write_text(path.read_text().replace("not a video", "not a movie"))
    assert any("checksum" in problem.found for problem in verify_catalog(tmp_path / "maps"))
    with pytest.warns(GeoaimWarning, match="is not a record"):
        assert build_catalog(table, tmp_path / "maps").built_now == ("broken",)
    assert verify_catalog(tmp_path / "maps") == []


@pytest.mark.slow
def test_index_and_report_list_the_records_of_other_and_stopped_runs(table, tmp_path, in_process):
    table.write_text("video,gcps\neast.mp4,gcps.csv\n")
    catalog = tmp_path / "maps"
    build_catalog(table, catalog)
    other = make_record(Recording("other", "other.mp4"), "refused", "no video")
    write_record(other, str(catalog / "recordings/other"))
    assert [problem.path for problem in verify_catalog(catalog)] == ["checksums.sha256"]
    assert build_catalog(table, catalog).built_now == ()
    assert "other" in (catalog / "report.html").read_text()
    assert verify_catalog(catalog) == []
    (table.parent / "gcps.csv").unlink()
    build_catalog(table, catalog)
    assert not (catalog / "items.parquet").exists()


@pytest.mark.slow
def test_a_damaged_record_is_named_and_built_again(table, tmp_path, in_process):
    build_catalog(table, tmp_path / "maps")
    record = tmp_path / "maps/recordings/east/record.json"
    record.write_bytes(record.read_bytes()[:100])
    with pytest.warns(GeoaimWarning, match="is not a record"):
        assert build_catalog(table, tmp_path / "maps").built_now == ("east",)
    assert verify_catalog(tmp_path / "maps") == []


def test_a_map_in_a_local_plane_has_an_item_without_geometry(table, tmp_path, in_process):
    table.write_text("video,frame_resolution\neast.mp4,0.05\n")
    build_catalog(table, tmp_path / "maps")
    item = pystac.Item.from_file(tmp_path / "maps/recordings/east/item.json")
    assert item.geometry is None
    assert not (tmp_path / "maps/items.parquet").exists()
    assert verify_catalog(tmp_path / "maps") == []


@pytest.mark.slow
def test_what_fails_outside_of_the_data_is_tried_again(table, tmp_path, in_process, monkeypatch):
    def fail(*_, **__):
        raise OSError("the store is full")

    monkeypatch.setattr(building, "upload", fail)
    catalog = build_catalog(table, tmp_path / "maps")
    assert catalog.records["east"].status == "failed"
    assert catalog.records["east"].reason == "the store is full"
    monkeypatch.undo()
    monkeypatch.setattr(
        catalog_pipeline, "run_tasks", lambda tasks, *_: map(build_recording, tasks)
    )
    assert build_catalog(table, tmp_path / "maps").built_now == ("east",)


@pytest.mark.parametrize(
    ("error", "cause", "status"),
    [
        (AimError("aim.tif could not be written"), OSError(errno.ENOSPC, "full"), "failed"),
        (AimError("aim.tif could not be written"), CPLE_OutOfMemoryError(1, 2, "GDAL"), "failed"),
        (GeoreferenceError("gcps.csv: cannot be read"), PermissionError(13, "denied"), "failed"),
        (VideoError("a.tif is damaged"), RasterioIOError("no TIFF"), "refused"),
        (VideoError("a.mp4 is damaged"), av.error.OSError(5, "input"), "refused"),
        (BackgroundError("no background"), None, "refused"),
    ],
)
def test_errors_of_the_machine_are_failures_and_those_of_the_data_refusals(
    table, tmp_path, monkeypatch, error, cause, status
):
    def fail(*_, **__):
        raise error from cause

    monkeypatch.setattr(building, "build_map", fail)
    recording = read_recordings(table)[0]
    record = build_recording(make_task(recording, list_inputs(recording), str(tmp_path / "maps")))
    assert (record.status, record.reason) == (status, str(error))


@pytest.mark.slow
def test_a_store_that_cannot_be_listed_fails_its_recordings_alone(
    table, tmp_path, in_process, monkeypatch
):
    build_catalog(table, tmp_path / "maps")
    calls = []

    def ls(self, path, **_):
        calls.append(path)
        raise RuntimeError("no credentials")

    monkeypatch.setattr("fsspec.implementations.memory.MemoryFileSystem.ls", ls)
    rows = "name,video\neast,memory://in/east.mp4\nb,memory://in/b.mp4\nhere,broken.mp4\n"
    table.write_text(rows)
    catalog = build_catalog(read_recordings(table, stores=["memory://in"]), tmp_path / "maps")
    status = {name: catalog.records[name].status for name in ("east", "b", "here")}
    assert status == {"east": "failed", "b": "failed", "here": "refused"}
    reason = catalog.records["b"].reason
    assert reason == "memory://in: RuntimeError: no credentials"
    assert len(calls) == 1
    assert read_catalog(tmp_path / "maps").records["east"].status == "built"
    assert verify_catalog(tmp_path / "maps") == []


def test_an_output_that_cannot_be_written_is_named_before_anything_is_built(
    table, tmp_path, in_process
):
    (tmp_path / "maps").write_text("a file")
    with pytest.raises(OSError, match="maps"):
        build_catalog(table, tmp_path / "maps")
    assert in_process == []


def test_reasons_cannot_break_the_page():
    record = make_record(Recording("a", "a.mp4"), "refused", "<script>alert(1)</script>")
    assert "<script>" not in format_page([record])


def test_the_command_builds_on_a_cluster_lists_and_shows(table, tmp_path):
    catalog = str(tmp_path / "maps")
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as cluster:
        address = cluster.scheduler_address
        result = run(app, ["catalog", "build", str(table), "-o", catalog, "--scheduler", address])
    assert result.exit_code == 0, result.output
    assert "1 built, 1 refused; 1 built by this run" in " ".join(result.output.split())
    assert "east" in run(app, ["catalog", "list", catalog]).output
    shown = run(app, ["catalog", "show", catalog, "east"])
    assert "registered frames" in shown.output
    assert run(app, ["catalog", "show", catalog, "north"]).exit_code == 1
    assert run(app, ["catalog", "verify", catalog]).exit_code == 0
    assert read_catalog(catalog).records["east"].status == "built"


def test_a_scheduler_that_does_not_answer_is_named(table, tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "CONNECT_S", 0.1)
    cluster = Cluster("tcp://127.0.0.1:9", patience=0.0)
    with pytest.raises(CatalogError, match="2 recordings are left"):
        build_catalog(read_recordings(table), tmp_path / "maps", cluster=cluster)


def test_an_empty_folder_is_no_catalogue(tmp_path):
    with pytest.raises(CatalogError, match="holds no recordings"):
        read_catalog(tmp_path)
    with pytest.raises(CatalogError, match="holds no recordings"):
        verify_catalog(tmp_path)
