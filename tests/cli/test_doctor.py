import subprocess
import sys

import pytest
from typer.testing import CliRunner

import geoaim
from geoaim.cli import app
from geoaim.cli.console import console


def test_version_is_printed():
    assert CliRunner().invoke(app, ["--version"]).output.strip() == geoaim.__version__


def test_doctor_names_versions_and_folders(monkeypatch, tmp_path):
    monkeypatch.setenv("GEOAIM_DATA", str(tmp_path / "missing"))
    with console.capture() as capture:
        assert CliRunner().invoke(app, ["doctor"]).exit_code == 0
    text = capture.get()
    for word in ("numpy", "opencv-contrib-python-headless", "GDAL", "no such folder"):
        assert word in text


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGTERM")
def test_terminated_command_removes_its_unfinished_files(tmp_path):
    script = (
        "import os, signal\n"
        "from geoaim.cli.console import report_errors, stop_when_terminated\n"
        "from geoaim.base.files import atomic_write\n"
        "stop_when_terminated()\n"
        f"with report_errors(), atomic_write({str(tmp_path / 'map.tif')!r}) as part:\n"
        "    part.write_text(''); os.kill(os.getpid(), signal.SIGTERM)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 143
    assert "unfinished ones are removed" in done.stderr
    assert list(tmp_path.iterdir()) == []
