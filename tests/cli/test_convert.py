"""Tracks written in other formats by the command."""

import json
import os
import shutil

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

import geoaim
from geoaim import read_tracks
from geoaim.base.pickles import read_pickle
from geoaim.cli import app
from geoaim.tracks.dates import read_start

run = CliRunner().invoke
SAMPLE = "samples/tracks.csv"


@pytest.mark.parametrize("name", ["a.parquet", "a.gpkg", "a.csv", "a"])
def test_sample_is_written_in_each_format_and_read_back(tmp_path, name):
    given = ["convert", SAMPLE, "-o", str(tmp_path / name), "--start", "10", "--duration", "5"]
    result = run(app, given)
    assert result.exit_code == 0, result.output
    tracks = geoaim.read_tracks(tmp_path / name)
    assert len(tracks.times) == 51
    assert f"{len(tracks.ids)} agents at 51 times" in " ".join(result.output.split())


def test_scenario_has_the_lanes_and_lights_of_the_map(tmp_path):
    given = ["convert", SAMPLE, "-o", str(tmp_path / "a"), "--hdmap", "samples/map.osm"]
    assert run(app, [*given, "--lights", "samples/lights.csv"]).exit_code == 0
    (path,) = (tmp_path / "a").glob("sd_*")
    content = read_pickle(path.read_bytes())
    assert content["map_features"] and content["dynamic_map_states"]  # noqa: PT018


def test_tables_in_pixels_are_converted(tmp_path):
    path = tmp_path / "pixels.csv"
    path.write_text("id,frame,x,y,type\n" + "".join(f"a,{k},{k},10,car\n" for k in range(9)))
    given = ["convert", str(path), "-o", str(tmp_path / "a.csv"), "--tracks-resolution", "0.1"]
    result = run(app, [*given, "--tracks-frame-rate", "10"])
    assert result.exit_code == 0, result.output
    assert geoaim.read_tracks(tmp_path / "a.csv").times[-1] == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["-o", "a.xyz"], "give a name that ends in .csv, .parquet or .gpkg"),
        (["-o", "a.csv", "--start", "900"], "no agent is present from 900"),
        (["-o", "a", "--rate", "5"], "not at 10 Hz throughout"),
    ],
)
def test_wrong_calls_end_in_a_line(tmp_path, given, message):
    target = [str(tmp_path / given[1]), *given[2:]]
    result = run(app, ["convert", SAMPLE, "-o", *target])
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())


def test_states_of_whole_tracks_are_written_with_a_warning(tmp_path):
    """TrajNet's windows have positions alone, from which headings and speeds are computed."""
    path = tmp_path / "windows.csv"
    path.write_text(
        "frame,track,u_px,v_px\n" + "".join(f"{12 * k},1,{10 * k},{k * k}\n" for k in range(20))
    )
    given = ["convert", str(path), "--tracks-resolution", "0.05", "-o"]
    result = run(app, [*given, str(tmp_path / "a.gpkg")])
    assert result.exit_code == 0
    assert "predict from the original" in " ".join(result.output.split())
    result = run(app, [*given, str(tmp_path / "a.csv")])
    assert "predict from the original" not in " ".join(result.output.split())
    read = [read_tracks(tmp_path / "a.csv"), read_tracks(path, resolution=0.05)]
    observed = [tracks.get_observed() for tracks in read]
    np.testing.assert_allclose(*observed, atol=6e-4)
    assert np.isnan(observed[0][:, 0]).all()


def test_files_of_one_recording_are_merged(tmp_path):
    for name, kind in (("v", "car"), ("p", "pedestrian")):
        rows = [f"{k},1,{kind},{k},{k},0,1,1,1" for k in range(5)]
        header = "time,id,type,x,y,heading,speed,length,width"
        (tmp_path / f"{name}.csv").write_text("\n".join([header, *rows]))
    given = ["convert", str(tmp_path / "v.csv"), str(tmp_path / "p.csv")]
    result = run(
        app, [*given, "-o", str(tmp_path / "both.csv"), "--tracks-world", "EPSG:32632 0 0"]
    )
    assert result.exit_code == 0, result.output
    both = read_tracks(tmp_path / "both.csv")
    assert both.types == ("car", "pedestrian")
    assert both.ids == ("1", "2-1")


@pytest.mark.parametrize("suffix", [".gpkg", ".parquet"])
def test_dates_are_given_or_those_of_the_file_or_its_video_or_said_to_be_unknown(tmp_path, suffix):
    def convert(source, name, *more):
        found = run(app, ["convert", str(source), "-o", str(tmp_path / f"{name}{suffix}"), *more])
        assert found.exit_code == 0, found.output
        return read_start(tmp_path / f"{name}{suffix}"), " ".join(found.output.split())

    start, said = convert("samples/tracks.csv", "a")
    assert str(start)[:10] == "1970-01-01"
    assert "(not known: give --start-date)" in said
    start, _ = convert("samples/tracks.csv", "b", "--start-date", "2026-06-01 12:00+02:00")
    assert start.isoformat() == "2026-06-01T10:00:00+00:00"
    again, said = convert(tmp_path / f"b{suffix}", "c", "--start", "4", "--rate", "5")
    assert abs(again - start) < pd.Timedelta("1ms")
    assert f"b{suffix})" in said
    folder = tmp_path / "placed"
    folder.mkdir()
    (folder / "map.tif").touch()
    shutil.copy("samples/tracks.csv", folder)
    shutil.copy("samples/hover.mp4", tmp_path)
    os.utime(tmp_path / "hover.mp4", (0, 86400))
    (folder / "report.json").write_text(json.dumps({"video": str(tmp_path / "hover.mp4")}))
    start, said = convert(folder, "d")
    assert start.isoformat() == "1970-01-02T00:00:00+00:00"
    assert "(time of the file)" in said


def test_dates_are_for_files_of_gis_programs(tmp_path):
    given = ["convert", "samples/tracks.csv", "--start-date", "2026-06-01"]
    refused = run(app, [*given, "-o", str(tmp_path / "a.csv")])
    assert refused.exit_code == 1
    assert "name the output .gpkg or .parquet" in " ".join(refused.output.split())
