import inspect
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

import geoaim
from geoaim.base.errors import GeoaimWarning, TracksError
from geoaim.base.progress import no_progress
from geoaim.cli import app
from geoaim.cli.inputs import lists_recordings, read_scene_sources, read_scenes
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.prediction.checkpoints import read_model, read_pretrained
from geoaim.prediction.plain import train_plain
from geoaim.tracks.changes import cut_tracks
from geoaim.tracks.files import write_tracks

run = CliRunner().invoke


@pytest.fixture(scope="module")
def aim(tmp_path_factory):
    """An AIM drawn from the bundled HD map."""
    path = tmp_path_factory.mktemp("aim") / "aim.tif"
    world = geoaim.read_tracks("samples/tracks.csv").world
    geoaim.write_aim(draw_hdmap(read_hdmap("samples/map_full.osm", world), resolution=0.5), path)
    return path


def set_min_ade(monkeypatch, *values):
    """Let validations of a training find given values of minADE, one after the other."""
    found = iter(values)
    monkeypatch.setattr("geoaim.prediction.training._validate", lambda *given: (1.0, next(found)))
    # nothing here looks at the network of the place, at that of its motion, or at spread futures
    monkeypatch.setattr(sys.modules["geoaim.prediction.predict"], "DRAWS", 1)
    monkeypatch.setitem(inspect.unwrap(train_plain).__kwdefaults__, "steps", 2)


def test_command_fine_tunes_the_pretrained_model_and_plots_the_training(aim, tmp_path, monkeypatch):
    set_min_ade(monkeypatch, 0.5, 0.4)
    given = ["train", str(aim), "--tracks", "samples/tracks.csv", "-o", str(tmp_path / "mine")]
    few = ["--steps", "2", "--batch-size", "4", "--val-fraction", "0.4"]
    done = run(app, [*given, *few])
    assert done.exit_code == 0, done.output
    assert "minADE 0.50 m before, 0.40 m after step 2" in " ".join(done.output.split())
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


@pytest.mark.slow
def test_a_training_that_makes_nothing_better_says_so_and_keeps_the_start(
    aim, tmp_path, monkeypatch
):
    set_min_ade(monkeypatch, 0.5, 0.63)
    given = ["train", str(aim), "--tracks", "samples/tracks.csv", "-o", str(tmp_path / "mine")]
    done = run(app, [*given, "--steps", "1", "--batch-size", "4", "--val-fraction", "0.4"])
    assert done.exit_code == 0, done.output
    said = " ".join(done.output.split())
    assert "no better than before: minADE 0.50 m before, 0.63 m after step 1" in said
    mine, before = read_model(tmp_path / "mine/model.pt"), read_pretrained("vehicle")
    for name, weights in before.state_dict().items():
        assert torch.equal(mine.state_dict()[name], weights)


def test_the_best_step_of_a_longer_training_is_kept(aim, tmp_path, monkeypatch):
    set_min_ade(monkeypatch, 0.5, 0.3, 0.4)
    monkeypatch.setattr(sys.modules["geoaim.cli.train"], "CHECKPOINT_STEPS", 1)
    given = ["train", str(aim), "--tracks", "samples/tracks.csv", "-o", str(tmp_path / "mine")]
    done = run(app, [*given, "--steps", "2", "--batch-size", "4", "--val-fraction", "0.4"])
    assert done.exit_code == 0, done.output
    assert "0.30 m after step 1, which is kept as the best" in " ".join(done.output.split())


@pytest.mark.slow
def test_models_of_cyclists_are_trained_from_scratch(aim, tmp_path):
    given = [str(aim), "--tracks", "samples/tracks.csv", "--kind", "cyclists"]
    mine = ["-o", str(tmp_path / "mine"), "--steps", "1", "--batch-size", "2"]
    short = ["--segment-duration", "3", "--val-fraction", "0.5", "--scratch"]
    done = run(app, ["train", *given, *mine, *short])
    assert done.exit_code == 0, done.output
    assert read_model(tmp_path / "mine/model.pt").config.kind == "cyclist"
    weights = ["--weights", str(tmp_path / "mine/model.pt"), "--samples", "2"]
    futures = tmp_path / "futures.csv"
    done = run(app, ["predict", *given, *weights, "--start", "50", "-o", str(futures)])
    assert done.exit_code == 0, done.output
    assert "cyclist" in futures.read_text()
    refused = run(app, ["predict", *given, "-o", str(futures)])
    assert refused.exit_code == 1
    assert "no model of cyclists comes with geoaim" in " ".join(refused.output.split())


@pytest.mark.slow
def test_command_trains_on_a_table_of_recordings(aim, tmp_path, monkeypatch):
    monkeypatch.setattr("geoaim.prediction.training.MAX_VAL_SEGMENTS", 4)
    tracks = geoaim.read_tracks("samples/tracks.csv")
    for name, start in (("early", 0.0), ("late", 30.0)):
        write_tracks(cut_tracks(tracks, start, 30.0), tmp_path / f"{name}.csv")
    table = tmp_path / "recordings.csv"
    table.write_text(f"aim,tracks,lights\n{aim},early.csv,\n{aim},late.csv,\n")
    sizes = ["--steps", "1", "--batch-size", "2", "--val-fraction", "0.4"]
    sizes += ["--segment-duration", "3", "--scratch"]
    given = ["train", str(table), *sizes, "-o", str(tmp_path / "mine")]
    done = run(app, given)
    assert done.exit_code == 0, done.output
    assert read_model(tmp_path / "mine/model.pt").config.kind == "vehicle"
    refused = run(app, [*given[:-1], str(tmp_path / "none"), "--tracks", "a.csv"])
    assert refused.exit_code == 1
    assert "leave their options out" in " ".join(refused.output.split())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("aim,trucks\na.tif,b.csv\n", "columns aim, trucks; needed are aim and tracks"),
        ("aim,tracks\n", "has no rows"),
        ("aim,tracks\na.tif,\n", "line 2: it names no tracks"),
        ("aim,tracks,tracks_frame_rate\na.tif,b.csv,fast\n", "tracks_frame_rate is 'fast'"),
        ("", "is not a CSV of recordings"),
    ],
)
def test_tables_that_cannot_be_read_are_refused(tmp_path, text, message):
    path = tmp_path / "recordings.csv"
    path.write_text(text)
    with pytest.raises(TracksError, match=message):
        read_scene_sources(path)


def test_recordings_of_one_map_share_its_ground(aim, tmp_path):
    path = tmp_path / "recordings.csv"
    tracks = Path("samples/tracks.csv").resolve()
    path.write_text(f"aim,tracks\n{aim},{tracks}\n{aim},{tracks}\n")
    one, other = read_scenes(read_scene_sources(path), 2.5, no_progress)
    assert one.ground is other.ground


def test_commas_at_the_ends_of_rows_shift_no_columns(tmp_path):
    path = tmp_path / "recordings.csv"
    path.write_text("aim,tracks\na.tif,b.csv,\n")
    (source,) = read_scene_sources(path)
    assert (source.aim, source.tracks) == (tmp_path / "a.tif", tmp_path / "b.csv")


def test_a_catalogue_gives_its_recordings_with_tracks_and_names_the_others(aim, tmp_path):
    pytest.importorskip("distributed", reason="pip install '.[catalog]'")
    from geoaim.catalog.building import make_record
    from geoaim.catalog.recordings import Recording
    from geoaim.catalog.records import OutputFile, get_folder, write_record

    for name, status in (("monday", "built"), ("night", "refused"), ("tuesday", "built")):
        folder = Path(get_folder(str(tmp_path), name))
        record = make_record(Recording(name, "a.mp4"), status, "")
        if status == "built":
            folder.mkdir(parents=True)
            (folder / "aim.tif").symlink_to(aim)
            write_tracks(geoaim.read_tracks("samples/tracks.csv"), folder / "tracks.parquet")
            record = replace(record, files={"tracks.parquet": OutputFile(1, "")})
        write_record(record, str(folder))
    with pytest.warns(GeoaimWarning, match="left out: night"):
        sources = read_scene_sources(tmp_path)
    assert [source.aim.parent.name for source in sources] == ["monday", "tuesday"]
    assert lists_recordings(tmp_path)
    assert not lists_recordings(aim)
    assert len(read_scenes(sources, 2.5, no_progress)) == 2
    few = "# crs: EPSG:32635\nid,type,time,x,y,heading,speed,length,width\n" + "".join(
        f"7,car,{time},{4 * time},0,0,4,4.5,1.8\n" for time in (0, 4, 8)
    )
    (tmp_path / "few.csv").write_text(few)
    sources[0] = replace(sources[0], tracks=tmp_path / "few.csv")
    with pytest.raises(TracksError, match=r"few\.csv"):
        read_scenes(sources, 2.5, no_progress)
    with pytest.warns(GeoaimWarning, match=r"recording is left out: .*few\.csv.* 4 s apart"):
        assert len(read_scenes(sources, 2.5, no_progress, skip=True)) == 1
    with pytest.raises(TracksError, match=r"few\.csv"):
        read_scenes(sources[:1], 2.5, no_progress, skip=True)
    empty = tmp_path / "empty"
    write_record(make_record(Recording("a", "a.mp4"), "refused", ""), get_folder(str(empty), "a"))
    with pytest.raises(TracksError, match="has tracks: give its table a column tracks"):
        read_scene_sources(empty)
