"""Each benchmark runs on tiny input and measures what its table says."""

import json
import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import benchmarks
from benchmarks import hover_videos, pipeline, short_clips
from benchmarks import results as report
from benchmarks.realism import benchmark as realism
from benchmarks.realism import images as realism_images
from benchmarks.realism import motion as realism_motion
from benchmarks.registration import benchmark as registration
from benchmarks.registration import methods as registration_methods
from benchmarks.registration import real as registration_real
from benchmarks.synthetic import make_sample, reference_from_frames, tracks_of
from benchmarks.synthetic.camera import render_background
from benchmarks.synthetic.scenery.texture import make_natural_noise
from geoaim.base.encode import write_video
from geoaim.mapping.registration.register import register

FOLDER = Path(benchmarks.__file__).parent
COMMANDS = [
    ".".join(path.relative_to(FOLDER.parent).with_suffix("").parts)
    for path in sorted(FOLDER.rglob("*.py"))
    if re.search(r"^def main\(.*JsonFile", path.read_text(), re.M | re.S)
]


@pytest.fixture
def video(monkeypatch):
    """A hover video of five frames over a synthetic still."""
    field = make_natural_noise((540, 960), 1.2, np.random.default_rng(0))
    grey = (110 + 30 * field).clip(0, 255).astype(np.uint8).repeat(4, axis=0).repeat(4, axis=1)
    sprite = np.full((48, 104, 4), 255, np.uint8)
    monkeypatch.setattr(hover_videos, "read_clean_still", lambda still: np.dstack([grey] * 3))
    monkeypatch.setattr(hover_videos, "cut_sprites", lambda still: [sprite])
    return hover_videos.make_hover_video("00003", size="720p", count=5)


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        ("geoaim", 0.1),
        ("KLT half + MAGSAC", 1.0),
        ("ECC quarter", 5.0),
        ("phase correlation half", 25.0),
    ],
)
def test_registration_methods_have_small_errors_on_a_plain_video(video, name, limit):
    method = registration_methods.list_methods()[name]
    row = registration.measure_rate_and_errors(method, video, list(video))
    assert row["frames_per_s"] > 0
    assert row["error_mean_px"] < limit


def test_identity_matrices_are_as_wrong_as_the_drift(video):
    truth = reference_from_frames(video.clip)
    size = video.clip.height, video.clip.width
    errors = registration.measure_corner_distances(np.tile(np.eye(3), (5, 1, 1)), truth, size)
    assert errors[0] == pytest.approx(0, abs=1e-6)
    assert errors[1:].max() > 1


def test_consistency_of_exact_registrations_is_zero(video):
    # of the first two frames the second is rejected, in which vehicles have moved by 2 px only
    one = register(list(video)[::2], reference_time=0.0)
    assert registration_real._measure_loop(one, one).max() < 1e-6
    assert registration_real._measure_forward_backward(one, one).max() < 1e-6


@pytest.mark.parametrize("name", COMMANDS)
def test_every_benchmark_is_a_command_with_help(name):
    command = typer.Typer()
    command.command()(import_module(name).main)
    result = CliRunner().invoke(command, ["--help"])
    assert result.exit_code == 0
    assert "--json" in result.output


@pytest.mark.slow
def test_cost_is_measured_in_a_new_process(video, tmp_path):
    clip = write_video(list(video), tmp_path / "clip.mp4")
    seconds, peak = report.run_in_process(pipeline._measure_cost, pipeline.decode, clip)
    assert seconds > 0
    assert peak > 50


@pytest.mark.slow
def test_pipeline_repeats_packets_and_counts_frames(video, tmp_path):
    clip = write_video(list(video), tmp_path / "clip.mp4")
    long = pipeline.repeat_packets(clip, tmp_path / "long.mp4", 0.4)
    assert pipeline.decode(long) == 15
    rows = list(pipeline.measure_throughput(clip))
    assert [row["method"] for row in rows][:2] == ["decode", "register_all"]
    assert all(row["frames_per_s"] > 0 for row in rows)


@pytest.mark.filterwarnings("ignore::geoaim.base.errors.GeoaimWarning")
@pytest.mark.slow
def test_short_clips_count_decoded_frames_and_the_error_of_the_map(video, tmp_path):
    clip = write_video(list(video), tmp_path / "clip.mp4", crf=10)
    auto, whole = short_clips.measure_clip(clip, render_background(video.clip))
    assert (auto["frames"], whole["frames"]) == ("auto", "all")
    assert 5 <= auto["decoded frames"] <= whole["decoded frames"]
    assert 0 < auto["RMSE, grey levels"] < 60


@pytest.mark.slow
def test_statistics_are_no_distance_from_themselves():
    field = make_natural_noise((800, 1600), 1.2, np.random.default_rng(0))
    grey = (110 + 30 * field).clip(0, 255).astype(np.uint8)
    image = realism_images.sample_statistics(np.dstack([grey] * 3))
    sample = make_sample(1, minutes=0.2, video=None)
    motion = realism_motion.measure_motion(tracks_of(sample), realism_motion.VEHICLES)
    rows = [*realism._compare("image", [image], {"a": image, "b": image})]
    rows += realism._compare("vehicles", [motion], {"a": motion})
    assert {"gradient", "spectrum", "acceleration, m/s2"} <= {row["statistic"] for row in rows}
    assert all(row["synthetic to real"] == 0 for row in rows)


def test_reports_hold_the_command_the_machine_and_the_rows(tmp_path):
    report.write_rows([{"a": np.float64(1.5)}], tmp_path / "x.json", command="python -m x", runs=2)
    content = json.loads((tmp_path / "x.json").read_text())
    assert content["rows"] == [{"a": 1.5}]
    assert (content["command"], content["runs"]) == ("python -m x", 2)
    assert content["machine"]["cores"] >= 1
    assert report.format_table([{"a": 1.23456}]) == "| a |\n| --- |\n| 1.23 |"


def test_rows_are_printed_as_they_are_measured(capsys):
    assert report.print_rows({"a": n} for n in (1, 2)) == [{"a": 1}, {"a": 2}]
    assert capsys.readouterr().out == "| a |\n| --- |\n| 1 |\n| 2 |\n"
