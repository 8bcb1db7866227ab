from typer.testing import CliRunner

from geoaim.cli import app
from geoaim.hdmap.lanelet2 import read_hdmap

run = CliRunner().invoke


def test_render_reads_tracks_in_other_formats(tmp_path):
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
    for world, message in (
        ([], "t.csv: the tracks lie in a local plane without a CRS"),
        (["--tracks-world", "EPSG:32635 0 0"], "t.csv: no track touches the map"),
        (["--tracks-world", "EPSG:32635 1"], "is not a CRS and two numbers"),
        (["--tracks-resolution", "0.1"], "takes no resolution"),
    ):
        result = run(app, [*given, *world])
        assert result.exit_code == 1
        assert message in " ".join(result.output.split())
    result = run(app, [*given, "--tracks-world", f"EPSG:32635 {origin[0]} {origin[1]}"])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "a.png").exists()


def test_lights_need_stop_lines(tmp_path):
    given = ["render", str(tmp_path / "aim.tif"), "--tracks", "t.csv", "--ego", "1"]
    result = run(app, [*given, "--lights", "lights.csv", "-o", str(tmp_path / "a.png")])
    assert result.exit_code == 1
    assert "--lights needs --hdmap" in result.output
