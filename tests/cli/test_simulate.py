import numpy as np
from PIL import Image
from shapely import LineString, MultiPolygon, box
from typer.testing import CliRunner

from geoaim.aim.files import write_aim
from geoaim.base.geojson import Feature
from geoaim.cli import app
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.tracks.formats import read_tracks
from tests.geojson_files import write_features

run = CliRunner().invoke


def test_render_writes_pictures_and_videos_around_an_agent(frames_folder, tmp_path):
    run(
        app,
        [
            "build",
            str(frames_folder),
            "--points",
            str(frames_folder / "gcps.csv"),
            "-o",
            f"{tmp_path}/aim.tif",
        ],
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


def test_simulate_writes_tracks_and_a_video_and_prints_rates(tmp_path):
    result = run(
        app, ["draw", "samples/map.osm", "--resolution", "0.5", "-o", f"{tmp_path}/aim.tif"]
    )
    assert result.exit_code == 0, result.output
    given = ["simulate", f"{tmp_path}/aim.tif", "--tracks", "samples/tracks.csv", "--start", "4"]
    given += ["--hdmap", "samples/map.osm", "--duration", "2", "-o", f"{tmp_path}/out.csv"]
    lights = ["--lights", "samples/lights.csv"]
    result = run(app, [*given, *lights, "--ego", "12", "--film", f"{tmp_path}/a.gif"])
    assert result.exit_code == 0, result.output
    output = " ".join(result.output.split())
    assert "1 agents by idm" in output
    assert all(name in output for name in ("collision", "red light", "off road", "wrong way"))
    assert len(read_tracks(tmp_path / "out.csv").times) == 21
    with Image.open(tmp_path / "a.gif") as video:
        assert video.n_frames == 21
    result = run(app, [*given, "--film", f"{tmp_path}/b.gif"])
    assert result.exit_code == 1
    assert "--film needs --ego" in result.output


def test_simulate_uses_hand_drawn_areas_and_stop_lines(tmp_path):
    hdmap = read_hdmap("samples/map.osm")
    write_aim(draw_hdmap(hdmap, resolution=0.5), tmp_path / "aim.tif")
    lines = [Feature(LineString(s.ends), {"signal": s.signal}) for s in hdmap.stop_lines]
    write_features(lines, hdmap.world, tmp_path / "lines.geojson")
    x, y = np.mean([line.ends for line in hdmap.stop_lines], axis=(0, 1))
    area = MultiPolygon([box(x, y, x + 1, y + 1)])
    write_features([Feature(area)], hdmap.world, tmp_path / "area.geojson")
    given = ["simulate", f"{tmp_path}/aim.tif", "--tracks", "samples/tracks.csv", "--start", "4"]
    given += ["--stop-lines", f"{tmp_path}/lines.geojson", "--lights", "samples/lights.csv"]
    given += ["--drivable", f"{tmp_path}/area.geojson", "--policy", "replay"]
    result = run(app, [*given, "--duration", "2", "-o", f"{tmp_path}/out.csv"])
    assert result.exit_code == 0, result.output
    output = " ".join(result.output.split())
    assert "off road │ 100 %, recorded 100 %" in output
    assert "red light" in output
    assert "wrong way" not in output


def test_simulate_by_the_model_that_comes_with_the_package(tmp_path):
    write_aim(draw_hdmap(read_hdmap("samples/map.osm"), resolution=0.5), tmp_path / "aim.tif")
    given = ["simulate", f"{tmp_path}/aim.tif", "--tracks", "samples/tracks.csv", "--start", "4"]
    given += ["--duration", "1", "-o", f"{tmp_path}/out.csv"]
    result = run(app, [*given, "--policy", "itra", "--ego", "12"])
    assert result.exit_code == 0, result.output
    assert "1 agents by itra" in result.output
    assert len(read_tracks(tmp_path / "out.csv").times) == 11
    result = run(app, [*given, "--weights", "model.pt"])
    assert result.exit_code == 1
    assert "idm has none; add --policy itra" in " ".join(result.output.split())
