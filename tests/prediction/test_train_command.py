from typer.testing import CliRunner

import geoaim
from geoaim.cli import app
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.prediction.checkpoints import read_model, read_pretrained

run = CliRunner().invoke


def test_command_fine_tunes_the_pretrained_model_and_plots_the_training(tmp_path, monkeypatch):
    monkeypatch.setattr("geoaim.prediction.training.MAX_VAL_SEGMENTS", 8)
    world = geoaim.read_tracks("samples/tracks.csv").world
    aim = str(tmp_path / "aim.tif")
    geoaim.write_aim(draw_hdmap(read_hdmap("samples/map_full.osm", world), resolution=0.5), aim)
    given = ["train", aim, "--tracks", "samples/tracks.csv", "-o", str(tmp_path / "mine")]
    few = ["--steps", "2", "--batch-size", "4", "--val-fraction", "0.4"]
    done = run(app, [*given, *few])
    assert done.exit_code == 0, done.output
    assert "trained on" in done.output
    mine, before = read_model(tmp_path / "mine/model.pt"), read_pretrained("vehicle")
    assert mine.config == before.config
    change = (mine.decode_action[0].weight - before.decode_action[0].weight).abs().max()
    assert 0 < change < 0.01
    assert (tmp_path / "mine/curves.png").read_bytes().startswith(b"\x89PNG")
    other = run(app, [*given, "--steps", "3", "--batch-size", "4", "--val-fraction", "0.4"])
    assert other.exit_code == 1
    assert "of another training" in other.output
    late = run(app, [*given[:-1], str(tmp_path / "none"), "--val-fraction", "0.01"])
    assert late.exit_code == 1
    assert "no validation segments" in late.output
    assert not (tmp_path / "none").exists()
