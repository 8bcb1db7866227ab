import http.server
import io
from pathlib import Path

import numpy as np
from PIL import Image
from typer.testing import CliRunner

from geoaim.aim.files import read_aim
from geoaim.cli import app
from tests.http_servers import run_servers

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
    aim = read_aim(output)
    assert aim.report["imagery"][0]["zoom"] == 19
    if (aim.coverage == 0).any():
        assert "are the same picture as another one" in " ".join(result.output.split())
