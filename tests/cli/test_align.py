import numpy as np
from typer.testing import CliRunner

from geoaim.aim.files import read_aim
from geoaim.cli import app

run = CliRunner().invoke


def test_align_corrects_an_orthophoto_by_tracks(tmp_path):
    output = tmp_path / "ortho.tif"
    given = ["align", "samples/ortho.tif", "--resolution", "0.4", "--max-shift", "8"]
    given += ["--max-rotation", "2"]
    result = run(app, [*given, "--tracks", "samples/tracks.csv", "-o", f"{output}"])
    assert result.exit_code == 0, result.output
    printed = " ".join(result.output.split())
    assert "alignment by tracks" in printed
    assert "m east" in printed
    assert output.with_suffix(".png").stat().st_size > 50_000
    east, north = read_aim(output).report["alignment"]["tracks"]["shift_m"]
    assert np.hypot(east + 4.26, north + 2.63) < 1


def test_align_writes_nothing_after_an_error(tmp_path):
    given = ["align", "samples/ortho.tif", "--resolution", "0.5", "-o", f"{tmp_path}/a.tif"]
    result = run(
        app, [*given, "--tracks", "samples/tracks.csv", "--tracks-world", "EPSG:32635 0 0"]
    )
    assert result.exit_code == 1
    assert run(app, ["align", "samples/ortho.tif", "-o", "samples/ortho.tif"]).exit_code == 1
    assert not list(tmp_path.iterdir())
