"""Days of one place: the second one is filmed from the other side, on a darker day."""

import subprocess
import sys
from itertools import islice

import cv2
import geopandas
import numpy as np
import pytest

from benchmarks.synthetic.camera import render_frames
from geoaim import read_aim, read_tracks
from geoaim.base.errors import CatalogError
from geoaim.base.geometry import transform_points
from geoaim.catalog import build_catalog, read_recordings, verify_catalog
from geoaim.catalog.pipeline import list_all_inputs, make_plan
from tests.catalog.conftest import build_in_process, write_table

TRACKS = "# crs: EPSG:32635\nid,type,time,x,y,heading,speed,length,width\n" + "".join(
    f"7,car,{step / 2},{583210 + 4 * step / 2},6062192,0,4,4.5,1.8\n" for step in range(5)
)
NEW = slice(100, 160), slice(300, 380)  # rows and columns of the second day that are painted
REFUSED = "fewer than 8 windows"


@pytest.fixture(scope="module")
def days(clip, clip_file, tmp_path_factory):
    """A table of two days of one place, of which the first alone has points, and of another."""
    table = write_table(clip_file, tmp_path_factory.mktemp("days") / "recordings")
    folder = table.parent
    small = np.random.default_rng(3).integers(0, 255, (90, 160, 3), np.uint8)
    other = cv2.resize(small, (640, 360), interpolation=cv2.INTER_CUBIC)
    for name in ("second", "water"):
        (folder / name).mkdir()
    for number, image in enumerate(islice(render_frames(clip), 5, 10)):
        turned = (image[::-1, ::-1] * 0.7).astype(np.uint8)
        turned[NEW] = 220
        cv2.imwrite(str(folder / f"second/{number}.png"), turned[..., ::-1])
        cv2.imwrite(str(folder / f"water/{number}.png"), other)
    (folder / "tracks.csv").write_text(TRACKS)
    table.write_text(
        "name,place,video,gcps,frame_resolution,datetime,tracks\n"
        "water,square,water,,0.05,2026-05-03T10:00Z,\n"
        "second,square,second,,0.055,2026-05-02T10:00Z,tracks.csv\n"
        "first,square,east.mp4,gcps.csv,,2026-05-01T10:00Z,tracks.csv\n"
    )
    return table


@pytest.fixture(scope="module")
def built(days):
    """The catalogue of these days, its folder, and the order in which it was built."""
    maps = days.parent / "maps"
    with pytest.MonkeyPatch.context() as patch:
        order = build_in_process(patch)
        return build_catalog(days, maps), maps, order


def test_all_days_of_a_place_lie_in_the_world_of_the_one_that_is_known_best(built, clip):
    catalog, maps, order = built
    status = {name: record.status for name, record in catalog.records.items()}
    assert status == {"first": "built", "second": "built", "water": "refused"}
    assert order[0] == "first"
    assert REFUSED in catalog.records["water"].reason
    first, second = (read_aim(maps / f"recordings/{name}/aim.tif") for name in ("first", "second"))
    assert first.world == second.world
    of_map = [day.report["registration"]["reference_index"] for day in (first, second)]
    places = np.array([[100.0, 100.0], [320.0, 180.0], [550.0, 300.0]])  # in the first day's image
    moved = clip.frame_from_background[5 + of_map[1]] @ np.linalg.inv(
        clip.frame_from_background[of_map[0]]
    )
    turned = [640.0, 360.0] - transform_points(moved, places)
    expected = transform_points(first.world_from_image, places)
    found = transform_points(second.world_from_image, turned)
    assert np.abs(found - expected).max() < 0.05
    assert verify_catalog(maps) == []


def test_tracks_of_all_days_are_in_one_file_with_dates(built):
    path = built[1] / "places/square/tracks.parquet"
    frame = geopandas.read_parquet(path)
    assert list(frame["recording"].unique()) == ["first", "second"]
    assert frame["datetime"].iloc[0].isoformat() == "2026-05-01T10:00:00+00:00"
    assert frame["datetime"].iloc[-1].isoformat() == "2026-05-02T10:00:02+00:00"
    assert frame.crs == "EPSG:32635"
    assert set(read_tracks(path).ids) == {"first/7", "second/7"}


def test_the_page_shows_each_day_what_changed_and_who_was_refused(built):
    catalog, maps, _ = built
    page = (maps / "report.html").read_text()
    assert page.index("square, 3 recordings") < page.index("<b>first") < page.index("<b>second")
    assert page.index("<b>second") < page.index(REFUSED)
    assert "places/square/tracks.parquet" in page
    painted = 60 * 80 / (360 * 640)
    assert catalog.records["second"].report["changed_share"] == pytest.approx(painted, rel=0.4)
    changes = cv2.imread(str(maps / "recordings/second/changes.jpg")).astype(int)
    red = (changes[..., 2] > 200) & (changes[..., 1] < 120)
    assert 0.5 * painted < np.ptp(np.argwhere(red), axis=0).prod() / red.size < 2 * painted


def test_a_second_run_builds_nothing_and_a_new_day_alone(days, built, tmp_path, in_process):
    _, maps, _ = built
    assert build_catalog(days, maps).built_now == ()
    more = days.parent / "more.csv"
    more.write_text(days.read_text() + "third,square,second,,0.055,2026-05-04T10:00Z,\n")
    assert build_catalog(more, maps).built_now == ("third",)


@pytest.mark.slow
def test_days_without_any_place_lie_in_the_plane_of_the_next_that_gives_a_map(
    days, tmp_path, in_process
):
    (days.parent / "no.csv").write_text("# crs: EPSG:32635\nname,u,v,x,y\n")
    local = days.parent / "local.csv"
    local.write_text(
        "name,place,video,gcps,frame_resolution\n"
        "first,square,east.mp4,no.csv,\n"
        "second,square,second,,0.055\n"
        "third,square,east.mp4,,0.05\n"
    )
    catalog = build_catalog(local, maps := tmp_path / "maps")
    assert in_process == ["first", "second", "first", "third"]
    assert catalog.records["first"].status == "refused"
    second, third = (read_aim(maps / f"recordings/{name}/aim.tif") for name in ("second", "third"))
    assert (second.world.crs, third.world) == (None, second.world)
    assert "relative to second (95 %)" in third.summarize()


def test_tables_name_what_is_wrong_in_a_cell_of_place_or_near(tmp_path):
    table = tmp_path / "table.csv"
    for cells, message in {
        "video,place\na.mp4,a/b\n": "the place 'a/b'",
        "video,near\na.mp4,north\n": "near 'north' is not",
        "video,near\na.mp4,91 10\n": "a latitude is at most 90",
        "video,gcps,imagery\na.mp4,a.csv,a.tif\n": "both place the map",
        "video,imagery\na.mp4,https://tiles.org/{z}/{x}/{y}.png\n": "https://tiles.org/.* allows",
    }.items():
        table.write_text(cells)
        with pytest.raises(CatalogError, match=message):
            read_recordings(table)


def test_an_orthophoto_is_an_input_and_the_first_of_its_place(tmp_path):
    for name in ("a.mp4", "b.mp4", "b.SRT", "ortho.tif"):
        (tmp_path / name).write_text("")
    table = tmp_path / "table.csv"
    table.write_text('video,place,imagery,near\nb.mp4,p,,\na.mp4,p,ortho.tif,"53.9, 27.5"\n')
    rows = read_recordings(table)
    inputs, _ = list_all_inputs(rows, {})
    assert [file.role for file in inputs["a"]] == ["video", "imagery"]
    (task,) = make_plan(rows, inputs, str(tmp_path / "maps")).list_ready({}, {})
    assert task.recording.name == "a"


def test_a_script_without_a_main_guard_gets_one_sentence(days, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        f"from geoaim.catalog import build_catalog\nbuild_catalog({str(days)!r}, 'm')\n"
    )
    command = [sys.executable, str(script)]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert "line 2, is run by each worker too" in ended.stderr.splitlines()[-1]
    assert ended.stderr.count("Traceback") == 1
