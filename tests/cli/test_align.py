import http.server
import io
from pathlib import Path

import numpy as np
import pytest
import rasterio
from PIL import Image
from typer.testing import CliRunner

from geoaim.aim.files import read_aim
from geoaim.cli import app
from geoaim.cli.inputs import read_any_aim
from tests.http_servers import run_servers

run = CliRunner().invoke
SHIFT = np.array([4.26, 2.63])  # metres by which the sample's imagery is stated wrongly


def test_an_orthophoto_is_taken_as_the_aim(tmp_path):
    output = tmp_path / "tiles.tif"
    given = ["align", "samples/tiles", "--aim", "samples/ortho.tif", "--resolution", "0.6"]
    result = run(app, [*given, "-o", str(output)])
    assert result.exit_code == 0, result.output
    shift = read_aim(output).report["alignment"]["aim"]["shift_m"]
    assert np.hypot(*shift) < 0.5


def test_of_a_large_orthophoto_the_part_that_is_needed_is_read(tmp_path):
    with rasterio.open("samples/ortho.tif") as ortho:
        window = rasterio.windows.Window(300, 400, 200, 150)
        profile = ortho.profile | {"width": 200, "height": 150}
        profile["transform"] = ortho.window_transform(window)
        with rasterio.open(tmp_path / "part.tif", "w", **profile) as part:
            part.write(ortho.read(window=window))
    aim = read_any_aim(Path("samples/ortho.tif"), [str(tmp_path / "part.tif")], None, 10.0)
    side = np.ptp(aim.corners, axis=0)
    assert (side >= [60, 50]).all()
    assert (side < [80, 75]).all()  # turned by the other CRS


def test_align_writes_nothing_after_an_error(tmp_path):
    given = ["align", "samples/ortho.tif", "--resolution", "0.5", "-o", f"{tmp_path}/a.tif"]
    result = run(
        app, [*given, "--tracks", "samples/tracks.csv", "--tracks-world", "EPSG:32635 0 0"]
    )
    assert result.exit_code == 1
    assert run(app, ["align", "samples/ortho.tif", "-o", "samples/ortho.tif"]).exit_code == 1
    assert not list(tmp_path.iterdir())


class SampleTiles(http.server.BaseHTTPRequestHandler):
    """The sample's tiles; every other tile is one grey picture, with status 200."""

    def do_GET(self) -> None:
        file = Path(f"samples/tiles{self.path}.jpg")
        grey = io.BytesIO()
        Image.new("RGB", (256, 256), (204, 204, 204)).save(grey, "JPEG")
        content = file.read_bytes() if file.exists() else grey.getvalue()
        self.send_response(200)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        pass


def test_the_guides_example_of_a_service_needs_no_resolution(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))  # of the cache of tiles
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    output = tmp_path / "aligned.tif"
    with run_servers(SampleTiles) as start:
        _, address = start()
        words = ["align", f"{address}/{{z}}/{{x}}/{{y}}", "--tracks", "samples/tracks.csv"]
        words += ["--max-shift", "8", "--max-rotation", "2", "-o", f"{output}"]
        result = run(app, words)
    assert result.exit_code == 0, result.output
    assert "alignment by tracks" in " ".join(result.output.split())
    assert output.with_suffix(".png").stat().st_size > 50_000
    aim = read_aim(output)
    assert np.hypot(*(aim.report["alignment"]["tracks"]["shift_m"] + SHIFT)) < 1
    assert aim.report["imagery"][0]["zoom"] == 19
    if (aim.coverage == 0).any():
        assert "are the same picture as another one" in " ".join(result.output.split())


def test_align_by_hand_says_so(tmp_path):
    output, stated = tmp_path / "a.tif", tmp_path / "b.tif"
    given = ["align", "samples/ortho.tif", "--resolution", "1"]
    result = run(app, [*given, "--shift", "2.5,-1", "-o", f"{output}"])
    assert result.exit_code == 0, result.output
    assert "moved by hand: +2.50 m east, -1.00 m north" in " ".join(result.output.split())
    result = run(app, [*given, "-o", f"{stated}"])
    assert "not aligned" in result.output
    moved = read_aim(output).corners + read_aim(output).world.origin
    before = read_aim(stated).corners + read_aim(stated).world.origin
    np.testing.assert_allclose(moved - before, [[2.5, -1.0]] * 4, atol=1e-6)
    result = run(app, [*given, "--shift", "2.5", "-o", f"{output}"])
    assert result.exit_code == 1
    assert "metres E,N or E,N,degrees" in result.output


@pytest.mark.parametrize("crs", ["EPSG:3346", "EPSG:32634"])
def test_align_writes_another_crs(tmp_path, crs):
    output = tmp_path / "a.tif"
    given = ["align", "samples/ortho.tif", "--resolution", "1"]
    result = run(app, [*given, "--output-crs", crs, "-o", f"{output}"])
    assert result.exit_code == 0, result.output
    with rasterio.open(output) as file, rasterio.open("samples/ortho.tif") as ortho:
        assert file.crs == crs
        assert file.dataset_mask().any()
        bounds = rasterio.warp.transform_bounds(file.crs, ortho.crs, *file.bounds)
        middles = [np.reshape(corners, (2, 2)).mean(axis=0) for corners in (bounds, ortho.bounds)]
    np.testing.assert_allclose(*middles, atol=2)


def test_align_keeps_the_extent(tmp_path):
    output = tmp_path / "a.tif"
    given = ["align", "samples/ortho.tif", "--tracks", "samples/tracks.csv", "--resolution", "0.5"]
    given += ["--max-shift", "6", "--max-rotation", "0", "--keep-extent", "-o", f"{output}"]
    result = run(app, given)
    assert result.exit_code == 0, result.output
    with rasterio.open(output) as file, rasterio.open("samples/ortho.tif") as ortho:
        sides = [
            (x.bounds.right - x.bounds.left, x.bounds.top - x.bounds.bottom) for x in (file, ortho)
        ]
    assert min(np.array(sides[0]) - sides[1]) > -1
