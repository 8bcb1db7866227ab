from typing import get_args

import numpy as np
import pytest
import rasterio
from PIL import Image
from shapely import LineString, MultiPolygon, box
from typer.testing import CliRunner

from geoaim.aim_files import read_aim, write_aim
from geoaim.cli import app
from geoaim.cli.made import PlaceKind
from geoaim.geojson import Feature, write_features
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.synthetic.camera import render_frame
from geoaim.synthetic.roads.layouts import PLACE_KINDS
from geoaim.track_files import read_tracks

run = CliRunner().invoke


@pytest.fixture(scope="module")
def folder(clip, tmp_path_factory):
    folder = tmp_path_factory.mktemp("frames")
    for index in range(6):
        Image.fromarray(render_frame(clip, index)).save(folder / f"{index:02d}.png")
    rows = [(40, 30), (600, 50), (580, 320), (60, 330), (300, 180)]
    lines = [f"p{i},{u},{v},{0.05 * u},{-0.05 * v}" for i, (u, v) in enumerate(rows)]
    (folder / "gcps.csv").write_text("# crs: local\nname,u,v,x,y\n" + "\n".join(lines))
    return folder


def test_build_writes_the_map_and_a_quick_look(folder, tmp_path):
    output = tmp_path / "aim.tif"
    result = run(app, ["build", str(folder), "--gcps", str(folder / "gcps.csv"), "-o", str(output)])
    assert result.exit_code == 0, result.output
    with rasterio.open(output) as file:
        assert file.transform.a == pytest.approx(0.05, rel=1e-3)
    assert output.with_suffix(".png").stat().st_size > 10_000


def test_an_error_is_one_line_and_exit_code_1_and_writes_nothing(folder, tmp_path):
    output = tmp_path / "aim.tif"
    result = run(app, ["build", str(folder), "-o", str(output)])
    assert result.exit_code == 1
    assert "give four or more control points" in " ".join(result.output.split())
    assert not list(tmp_path.iterdir())


def test_register_writes_a_row_a_frame(folder, tmp_path):
    output = tmp_path / "registration.csv"
    assert run(app, ["register", str(folder), "-o", str(output)]).exit_code == 0
    assert len(np.loadtxt(output, delimiter=",", skiprows=1, usecols=(0, 1))) == 6


def test_texture_and_info_read_what_build_wrote(folder, tmp_path):
    output = tmp_path / "aim.tif"
    run(app, ["build", str(folder), "--frame-resolution", "0.05", "-o", str(output)])
    assert run(app, ["texture", str(output), str(tmp_path / "out")]).exit_code == 0
    assert (tmp_path / "out" / "texture.json").exists()
    assert "640 x 360 px" in run(app, ["info", str(output)]).output


def test_a_wrong_number_of_frames_is_told_at_once(folder, tmp_path):
    result = run(app, ["build", str(folder), "--frames", "some", "-o", str(tmp_path / "a.tif")])
    assert result.exit_code == 2
    assert "auto, all or a number" in " ".join(result.output.split())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-o", "map.png"], "ends in .tif"),
        (["-o", "map.tif", "--gcps", "a.csv", "--frame-resolution", "1"], "give one"),
        (["-o", "."], "ends in .tif"),
        (["-o", "taken/map.tif"], "is a file; a folder is needed"),
    ],
)
def test_what_cannot_be_written_or_meant_is_refused_before_the_work(
    folder, tmp_path, monkeypatch, options, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("a file")
    result = run(app, ["build", str(folder), *options])
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_names_in_square_brackets_are_shown_as_they_are(tmp_path):
    result = run(app, ["info", str(tmp_path / "no[b]where[/b].tif")])
    assert result.exit_code == 1
    assert "no[b]where[/b].tif" in result.output.replace("\n", "")


def test_render_draws_the_map_around_an_agent(folder, tmp_path):
    run(
        app, ["build", str(folder), "--gcps", str(folder / "gcps.csv"), "-o", f"{tmp_path}/aim.tif"]
    )
    rows = [f"7,car,{k / 10},{15 + k},-9,0,10,4.5,1.8" for k in range(4)]
    names = "id,type,time,x,y,heading,speed,length,width"
    (tmp_path / "t.csv").write_text("\n".join(["# crs: local", names, *rows]))
    given = ["render", f"{tmp_path}/aim.tif", "--tracks", f"{tmp_path}/t.csv", "--size", "64"]
    for name in ("view.png", "view.mp4"):
        result = run(app, [*given, "--ego", "7", "-o", f"{tmp_path}/{name}"])
        assert result.exit_code == 0, result.output
    with Image.open(tmp_path / "view.png") as picture:
        assert picture.size == (64, 64)
    result = run(app, [*given, "--ego", "8", "-o", f"{tmp_path}/other.png"])
    assert result.exit_code == 1
    assert "there is no agent '8' among 1: 7" in " ".join(result.output.split())
    assert not (tmp_path / "other.png").exists()


def test_simulate_writes_tracks_and_a_film_and_counts(tmp_path):
    result = run(
        app, ["draw", "samples/map.osm", "--resolution", "0.5", "-o", f"{tmp_path}/aim.tif"]
    )
    assert result.exit_code == 0, result.output
    given = ["simulate", f"{tmp_path}/aim.tif", "--tracks", "samples/tracks.csv", "--start", "4"]
    given += ["--hdmap", "samples/map.osm", "--seconds", "2", "-o", f"{tmp_path}/out.csv"]
    lights = ["--lights", "samples/lights.csv"]
    result = run(app, [*given, *lights, "--ego", "12", "--film", f"{tmp_path}/a.gif"])
    assert result.exit_code == 0, result.output
    said = " ".join(result.output.split())
    assert "1 agents by idm" in said
    assert all(name in said for name in ("collision", "red light", "off road", "wrong way"))
    assert len(read_tracks(tmp_path / "out.csv").times) == 21
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 21
    result = run(app, [*given, "--film", f"{tmp_path}/b.gif"])
    assert result.exit_code == 1
    assert "--film needs --ego" in result.output


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["draw", "samples/map.osm", "-o", "a.png"], "ends in .tif or .tiff"),
        (["draw", "a.tif", "-o", "a.tif"], "is read as well"),
        (["draw", "samples/map.osm", "--aim", "a.tif", "-o", "./a.tif"], "is read as well"),
        (["render", "a.tif", "--tracks", "t", "--ego", "1", "-o", "a.avi"], "ends in .mp4"),
        (["simulate", "a.tif", "--tracks", "t", "-o", "a.txt"], "ends in .csv or .parquet"),
        (["simulate", "a.tif", "--tracks", "t.csv", "-o", "t.csv"], "is read as well"),
        (
            ["simulate", "a.tif", "--tracks", "t", "-o", "o.csv", "--film", "f.png"],
            "ends in .mp4 or .gif",
        ),
        (
            ["simulate", "a.tif", "--tracks", "t", "-o", "o.csv", "--stop-lines", "l.geojson"],
            "--stop-lines needs --lights",
        ),
    ],
)
def test_what_would_be_lost_or_ignored_is_refused_before_the_work(options, said):
    result = run(app, options)
    assert result.exit_code == 1
    assert said in " ".join(result.output.split())


def test_simulate_counts_by_what_is_drawn_by_hand(tmp_path):
    hdmap = read_hdmap("samples/map.osm")
    write_aim(draw_hdmap(hdmap, resolution=0.5), tmp_path / "aim.tif")
    lines = [Feature(LineString(s.ends), {"signal": s.signal}) for s in hdmap.stop_lines]
    write_features(lines, hdmap.world, tmp_path / "lines.geojson")
    nowhere = MultiPolygon([box(0, 0, 1, 1)])
    write_features([Feature(nowhere)], hdmap.world, tmp_path / "area.geojson")
    given = ["simulate", f"{tmp_path}/aim.tif", "--tracks", "samples/tracks.csv", "--start", "4"]
    given += ["--stop-lines", f"{tmp_path}/lines.geojson", "--lights", "samples/lights.csv"]
    given += ["--drivable", f"{tmp_path}/area.geojson", "--policy", "replay"]
    result = run(app, [*given, "--seconds", "2", "-o", f"{tmp_path}/out.csv"])
    assert result.exit_code == 0, result.output
    said = " ".join(result.output.split())
    assert "off road 100.00 %" in said
    assert "red light" in said
    assert "wrong way" not in said


def test_render_reads_tracks_of_other_forms(tmp_path):
    result = run(
        app, ["draw", "samples/map.osm", "--resolution", "0.5", "-o", f"{tmp_path}/aim.tif"]
    )
    assert result.exit_code == 0, result.output
    origin = read_hdmap("samples/map.osm").world.origin
    rows = [f"7,{k},{100 * k},car,{k},0,10,0,0,4.5,1.8" for k in range(4)]
    names = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width"
    (tmp_path / "t.csv").write_text("\n".join([names, *rows]))
    given = ["render", f"{tmp_path}/aim.tif", "--tracks", f"{tmp_path}/t.csv", "--size", "64"]
    given += ["--ego", "7", "-o", f"{tmp_path}/a.png"]
    for world, said in (
        ([], "give both a place on the Earth"),
        (["--tracks-world", "EPSG:32635 1"], "is not a CRS and two numbers"),
        (["--tracks-resolution", "0.1"], "in metres; give no resolution"),
    ):
        result = run(app, [*given, *world])
        assert result.exit_code == 1
        assert said in " ".join(result.output.split())
    result = run(app, [*given, "--tracks-world", f"EPSG:32635 {origin[0]} {origin[1]}"])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "a.png").exists()


def test_lights_need_the_map_with_their_lines(tmp_path):
    given = ["render", str(tmp_path / "aim.tif"), "--tracks", "t.csv", "--ego", "1"]
    result = run(app, [*given, "--lights", "lights.csv", "-o", str(tmp_path / "a.png")])
    assert result.exit_code == 1
    assert "--lights needs --hdmap" in result.output


def test_align_lays_an_orthophoto_under_tracks(tmp_path):
    output = tmp_path / "ortho.tif"
    given = ["align", "samples/ortho.tif", "--resolution", "0.4", "--reach", "8", "--turn", "2"]
    result = run(app, [*given, "--tracks", "samples/tracks.csv", "-o", f"{output}"])
    assert result.exit_code == 0, result.output
    said = " ".join(result.output.split())
    assert "alignment by tracks" in said
    assert "m east" in said
    assert output.with_suffix(".png").stat().st_size > 50_000
    east, north = read_aim(output).report["alignment"]["tracks"]["shift_m"]
    assert np.hypot(east + 4.26, north + 2.63) < 1


def test_align_writes_nothing_when_it_refuses(tmp_path):
    given = ["align", "samples/ortho.tif", "--resolution", "0.5", "-o", f"{tmp_path}/a.tif"]
    result = run(
        app, [*given, "--tracks", "samples/tracks.csv", "--tracks-world", "EPSG:32635 0 0"]
    )
    assert result.exit_code == 1
    assert run(app, ["align", "samples/ortho.tif", "-o", "samples/ortho.tif"]).exit_code == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "given",
    [
        ["align", "shot.png", "--gcps", "points.csv", "-o", "shot.tif"],
        ["align", "*.png", "-o", "shot.tif"],
        ["align", "tiles", "-o", "tiles/19/7.tif"],
        ["align", "other.tif", "--gcps", "points.tif", "-o", "points.tif"],
        ["align", "other.tif", "--gcps", "shot.png", "-o", "shot.tif"],
        ["build", "shot.png", "--gcps", "points.csv", "-o", "shot.tif"],
        ["build", "tiles/19", "-o", "tiles/19/7.tif"],
        ["build", "other.mp4", "--gcps", "points.tif", "-o", "points.tif"],
    ],
)
def test_neither_map_nor_look_replaces_what_is_read(tmp_path, monkeypatch, given):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiles" / "19").mkdir(parents=True)
    for name in ("shot.png", "points.tif", "points.csv", "tiles/19/7.png"):
        (tmp_path / name).write_text(name)
    result = run(app, given)
    assert result.exit_code == 1
    said = " ".join(result.output.split())
    assert "which is read" in said or "is read as well" in said
    assert (tmp_path / given[-1]).exists() == (given[-1] == "points.tif")
    for name in ("shot.png", "points.tif", "points.csv", "tiles/19/7.png"):
        assert (tmp_path / name).read_text() == name


def test_sample_offers_every_kind_of_place():
    assert get_args(PlaceKind) == PLACE_KINDS


def test_sample_is_not_written_among_other_files(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    result = run(app, ["sample", str(tmp_path)])
    assert result.exit_code == 1
    assert "is not a sample; name a new folder" in " ".join(result.output.split())
