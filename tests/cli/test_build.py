import json

import numpy as np
import pytest
import rasterio
from PIL import Image
from typer.testing import CliRunner

from geoaim.aim.files import read_aim
from geoaim.cli import app
from geoaim.mapping.video.video import open_video

run = CliRunner().invoke


def test_build_writes_the_map_and_a_quick_look(frames_folder, tmp_path):
    output = tmp_path / "aim.tif"
    result = run(
        app,
        [
            "build",
            str(frames_folder),
            "--points",
            str(frames_folder / "gcps.csv"),
            "-o",
            str(output),
        ],
    )
    assert result.exit_code == 0, result.output
    with rasterio.open(output) as file:
        assert file.transform.a == pytest.approx(0.05, rel=1e-3)
    assert output.with_suffix(".png").stat().st_size > 10_000


def test_a_still_becomes_a_map_by_its_resolution_or_by_control_points(frames_folder, tmp_path):
    still, output = str(next(frames_folder.glob("*0.png"))), tmp_path / "aim.tif"
    with Image.open(still) as image:
        width, height = image.size
        pixels = np.asarray(image.convert("RGB"))
    result = run(app, ["build", still, "--resolution", "0.05", "-o", str(output)])
    assert result.exit_code == 0, result.output
    assert "the map is a single image" in " ".join(result.output.split())
    aim = read_aim(output)
    corners = 0.05 * np.array([[0, 0], [width, 0], [width, -height], [0, -height]])
    np.testing.assert_allclose(aim.corners, corners, atol=1e-6)
    assert np.abs(aim.image.astype(int) - pixels).max() <= 2
    given = [still, "--resolution", "0.05", "--frame-origin", "middle"]
    assert run(app, ["build", *given, "-o", str(output)]).exit_code == 0
    np.testing.assert_allclose(read_aim(output).corners, corners - corners.mean(0), atol=1e-6)
    (tmp_path / "gcps.csv").write_text((frames_folder / "gcps.csv").read_text())
    given = [still, "--points", str(tmp_path / "gcps.csv")]
    result = run(app, ["build", *given, "-o", str(output)])
    assert result.exit_code == 0, result.output
    assert read_aim(output).report["georeference"]["points"]


def test_an_error_is_one_line_and_exit_code_1_and_writes_nothing(frames_folder, tmp_path):
    output = tmp_path / "aim.tif"
    result = run(app, ["build", str(frames_folder), "-o", str(output)])
    assert result.exit_code == 1
    assert "give four or more control points" in " ".join(result.output.split())
    assert not list(tmp_path.iterdir())


def test_frame_saves_a_frame_of_the_video(frames_folder, tmp_path):
    output = tmp_path / "frame.png"
    command = ["frame", str(frames_folder), "--time", "2", "-o", str(output)]
    assert run(app, command).exit_code == 0
    saved = np.asarray(Image.open(output))
    np.testing.assert_array_equal(saved, list(open_video(frames_folder))[2].image)


def test_frame_after_the_end_is_refused_with_the_length_of_the_video(tmp_path):
    result = run(app, ["frame", "samples/hover.mp4", "--time", "99", "-o", f"{tmp_path}/a.png"])
    assert result.exit_code == 1
    assert "has no frame at 99 s: it lasts 12.00 s" in result.output
    assert not list(tmp_path.iterdir())


def test_register_writes_a_row_for_each_frame(frames_folder, tmp_path):
    output = tmp_path / "registration.csv"
    assert run(app, ["register", str(frames_folder), "-o", str(output)]).exit_code == 0
    assert len(np.loadtxt(output, delimiter=",", skiprows=1, usecols=(0, 1))) == 6


def test_json_has_the_files_and_the_table(frames_folder, tmp_path):
    output = tmp_path / "registration.csv"
    result = run(app, ["register", str(frames_folder), "-o", str(output), "--json"])
    content = json.loads(result.stdout)
    assert content["files"] == [str(output)]
    assert content["summary"]["registered frames"] == "6 of 6"


@pytest.mark.slow
def test_texture_and_info_read_what_build_wrote(frames_folder, tmp_path):
    output = tmp_path / "aim.tif"
    run(app, ["build", str(frames_folder), "--frame-resolution", "0.05", "-o", str(output)])
    assert run(app, ["texture", str(output), str(tmp_path / "out")]).exit_code == 0
    assert (tmp_path / "out" / "texture.json").exists()
    assert "640 x 360 px" in run(app, ["info", str(output)]).output


def test_an_invalid_number_of_frames_is_refused(frames_folder, tmp_path):
    result = run(
        app, ["build", str(frames_folder), "--frames", "some", "-o", str(tmp_path / "a.tif")]
    )
    assert result.exit_code == 2
    assert "auto, all or a number" in " ".join(result.output.split())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-o", "map.png"], "ends in .tif"),
        (["-o", "map.tif", "--points", "a.csv", "--frame-resolution", "1"], "exclude each other"),
        (["-o", "map.tif", "--points", "a.csv", "--yaw", "1"], "complete telemetry"),
        (["-o", "."], "ends in .tif"),
        (["-o", "taken/map.tif"], "is a file; a folder is needed"),
    ],
)
def test_unwritable_outputs_and_contradicting_options_are_refused_before_the_work(
    frames_folder, tmp_path, monkeypatch, options, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("a file")
    result = run(app, ["build", str(frames_folder), *options])
    assert result.exit_code == 1
    assert message in " ".join(result.output.split())
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]
