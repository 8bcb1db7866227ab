from pathlib import Path

import fsspec
import pytest

from geoaim.base.errors import CatalogError
from geoaim.catalog import read_recordings
from geoaim.catalog.recordings import Recording, fetch_inputs, list_inputs
from geoaim.mapping.build_map import MapSettings


def write(folder, text):
    path = folder / "recordings.csv"
    path.write_text(text)
    return path


def test_rows_have_addresses_relative_to_the_table_and_settings(tmp_path):
    table = write(
        tmp_path,
        "name,video,gcps,detections,datetime,frames,frame_resolution\n"
        "first,clips/a.mp4,gcps.csv,boxes,2026-01-02T03:04:05Z,16,\n"
        ",s3://bucket/b.mp4,,,,,0.05\n",
    )
    first, second = read_recordings(table, stores=["s3://bucket/"])
    assert first.video == f"{tmp_path}/clips/a.mp4"
    assert (first.gcps, first.detections) == (f"{tmp_path}/gcps.csv", f"{tmp_path}/boxes")
    assert first.settings == MapSettings(frames=16)
    assert (second.name, second.video) == ("b", "s3://bucket/b.mp4")
    assert second.gcps is None
    assert second.settings == MapSettings(frame_resolution=0.05)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("film\na.mp4\n", "has the columns film; needed is video"),
        ("video,speed\na.mp4,3\n", "allowed are name, video"),
        ("video\n", "has no recordings"),
        ("name,video\na,\n", "line 2: it names no video"),
        ("video\na.mp4\nb/a.mp4\n", r"1 names more than once \(a\)"),
        ("video\nä.mp4\n", "line 2: the name 'ä'"),
        ("video,frames\na.mp4,most\n", "line 2: 'most' is not auto, all or a number"),
        ("video,resolution\na.mp4,fine\n", "line 2: resolution is 'fine'; a finite number"),
        ("video,resolution\n\na.mp4,nan\n", "line 3: resolution is 'nan'; a finite number"),
        ("video,height\na.mp4,inf\n", "line 2: height is 'inf'"),
        ("video,gcps\na.mp4,b.csv,c.csv\n", "line 2 has 3 cells for 2 columns"),
        ("video,video\na.mp4,b.mp4\n", "each once"),
        ("video,frame_origin\na.mp4,left\n", "corner or middle is needed"),
        ("video,datetime\na.mp4,yesterday\n", "line 2: Invalid isoformat"),
        ("", "is not a CSV of recordings"),
    ],
)
def test_a_table_that_cannot_be_understood_is_refused(tmp_path, text, message):
    with pytest.raises(CatalogError, match=message):
        read_recordings(write(tmp_path, text))


def test_commas_at_the_end_of_lines_shift_no_columns(tmp_path):
    table = write(tmp_path, "video,gcps\na.mp4,a.csv,\nb.mp4,b.csv,,\n\n,,\nc.mp4\n")
    rows = [(row.name, row.gcps and row.gcps[-5:]) for row in read_recordings(table)]
    assert rows == [("a", "a.csv"), ("b", "b.csv"), ("c", None)]
    assert read_recordings(write(tmp_path, "video,\na.mp4,\n"))[0].name == "a"


def test_a_missing_table_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.csv"):
        read_recordings(tmp_path / "nowhere.csv")


@pytest.mark.parametrize(
    ("video", "fetched", "count"),
    [("a.mp4", "video/a.mp4", 1), ("photos", "video", 2), ("photos/*.png", "video/*.png", 1)],
)
def test_a_file_a_folder_and_a_pattern_of_a_store_are_fetched(tmp_path, video, fetched, count):
    store = fsspec.filesystem("memory")
    for name in ("a.mp4", "photos/a.png", "photos/b.jpg", "photos/notes.md"):
        store.pipe_file(f"/recordings/{name}", name.encode())
    recording = Recording("a", f"memory://recordings/{video}")
    local, paths = fetch_inputs(recording, list_inputs(recording), tmp_path)
    assert Path(local.video) == tmp_path / fetched
    assert len(paths) == count
    assert all(path.read_bytes().decode().endswith(path.name) for path in paths)


def test_telemetry_has_the_name_of_its_video(tmp_path):
    for name in ("day.1.mp4", "day.1.srt", "day.srt", "day.2.srt"):
        (tmp_path / name).write_text(name)
    found = list_inputs(Recording("a", str(tmp_path / "day.1.mp4")))
    assert [(file.role, file.name) for file in found] == [
        ("video", "day.1.mp4"),
        ("telemetry", "day.1.srt"),
    ]
