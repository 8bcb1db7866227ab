import json
import shlex
import shutil

import numpy as np
import pytest
import typer
from PIL import Image
from typer.testing import CliRunner

import geoaim
from geoaim.base.errors import GeoaimError
from geoaim.cli import app
from geoaim.cli.info import describe_file
from geoaim.mapping.registration.register import register, write_registration
from geoaim.prediction.checkpoints import PRETRAINED
from geoaim.tracks.formats import write_geopackage
from tests.aim.test_aim import make_aim
from tests.tracks.formats import scenarionet_files

run = CliRunner().invoke
KINDS = {
    "samples/hover.mp4": "video",
    "samples/background.jpg": "image",
    "samples/hover.SRT": "telemetry of a drone",
    "samples/ortho.tif": "imagery",
    "samples/tiles": "imagery",
    "samples/boxes": "detections (YOLO)",
    "samples/tracks.csv": "tracks (plain format)",
    "samples/lights.csv": "traffic lights",
    "samples/gcps.csv": "control points",
    "samples/map.osm": "HD map (lanelet2)",
    "samples/surfaces.geojson": "hand-drawn shapes (GeoJSON)",
    str(PRETRAINED / "vehicle.pt"): "prediction model",
    "https://tiles.example/{z}/{x}/{y}.png": "tile service",
}


def check_commands(commands, source):
    """Each command that is proposed has only options that exist."""
    group = typer.main.get_command(app)
    for command in commands:
        name, *words = shlex.split(command.replace("FILE", shlex.quote(source)))
        group.commands[name].make_context(name, words).close()


@pytest.mark.parametrize(("source", "kind"), KINDS.items())
def test_kind_of_each_file_of_the_sample_and_the_commands_that_use_it(source, kind):
    found, _, commands = describe_file(source)
    assert found == kind
    check_commands(commands, source)


def test_maps_textures_folders_and_tables_that_geoaim_writes_are_known(tmp_path):
    geoaim.write_aim(make_aim(), tmp_path / "aim.tif")
    geoaim.export_texture(make_aim(), tmp_path / "texture")
    frames = [frame.image for frame in geoaim.open_video("samples/hover.mp4").sample(2)]
    write_registration(register(frames), tmp_path / "registration.csv")
    (tmp_path / "points").mkdir()
    (tmp_path / "points" / "gcp_list.txt").write_text("EPSG:32635\n1 2 0 3 4 a.jpg\n")
    (tmp_path / "futures.csv").write_text("# crs: local\nsample,id,type,time,x,y,heading,speed\n")
    kinds = {
        "aim.tif": "AIM: a map",
        "texture": "corner frame of a texture",
        "texture/texture.json": "corner frame of a texture",
        "texture/texture.png": "corner frame of a texture",
        "registration.csv": "registration of the frames of a video",
        "points/gcp_list.txt": "control points",
        "futures.csv": "futures that predict wrote",
    }
    for name, kind in kinds.items():
        found, _, commands = describe_file(str(tmp_path / name))
        assert found == kind
        check_commands(commands, str(tmp_path / name))


def test_scenarios_of_other_simulators_are_known(tmp_path):
    scenarionet_files.write(tmp_path / "sd_0.pkl")
    write_geopackage(geoaim.read_tracks("samples/tracks.csv"), tmp_path / "a.gpkg")
    for name, kind in {"sd_0.pkl": "ScenarioNet", "a.gpkg": "GeoPackage"}.items():
        found, facts, commands = describe_file(str(tmp_path / name))
        assert found == f"tracks ({kind} format)"
        assert facts
        check_commands(commands, str(tmp_path / name))


def test_info_prints_facts_and_commands_or_json():
    output = run(app, ["info", "samples/map.osm"]).output
    assert "26 road" in output
    assert "  geoaim draw samples/map.osm -o map.tif\n" in output
    content = json.loads(run(app, ["info", "samples/hover.mp4", "--json"]).stdout)
    assert content["summary"]["length"] == "12.00 s, 25 frames/s"
    assert content["commands"][0] == "geoaim place samples/hover.mp4 -o FOLDER"


def test_other_files_are_refused_in_one_line(tmp_path):
    np.savez(tmp_path / "a.npz", a=1)
    (tmp_path / "a.csv").write_text("some,table\n1,2\n")
    (tmp_path / "a.json").write_text("{}")
    (tmp_path / "empty").mkdir()
    for name in ("a.npz", "a.csv", "a.json", "empty"):
        with pytest.raises(GeoaimError) as raised:
            describe_file(str(tmp_path / name))
        assert name in str(raised.value)
        assert "\n" not in str(raised.value)
    with pytest.raises(FileNotFoundError, match="no such file or folder"):
        describe_file(str(tmp_path / "nowhere.csv"))


def test_folder_of_geotiffs_is_imagery_whatever_lies_beside_them(tmp_path):
    shutil.copy("samples/ortho.tif", tmp_path / "a.tif")
    (tmp_path / "notes.txt").write_text("0 0.5 0.5 0.1 0.1")
    kind, facts, _ = describe_file(str(tmp_path))
    assert kind == "imagery"
    assert facts["files"] == "1"


def test_tracks_as_geojson_points_are_no_hand_drawn_shapes(tmp_path):
    point = {"type": "Point", "coordinates": [25.3, 54.7]}
    feature = {"type": "Feature", "geometry": point, "properties": {"id": "7", "time": 0.1}}
    collection = {"type": "FeatureCollection", "features": [feature, feature]}
    (tmp_path / "a.geojson").write_text(json.dumps(collection))
    kind, facts, _ = describe_file(str(tmp_path / "a.geojson"))
    assert kind == "tracks (GeoJSON points)"
    assert "GeoPackage" in facts["read as"]


def test_image_with_a_prj_or_an_aux_xml_is_imagery(tmp_path):
    path = tmp_path / "a.png"
    Image.fromarray(np.zeros((4, 6, 3), np.uint8)).save(path)
    path.with_suffix(".wld").write_text("1\n0\n0\n-1\n500000\n5000000")
    assert describe_file(str(path))[1] == {"CRS": "not stated: give --crs"}
    path.with_suffix(".prj").write_text("EPSG:32632")
    assert describe_file(str(path))[1]["first"] == "6 x 4 px, EPSG:32632"
