from importlib import import_module
from pathlib import Path

from typer.testing import CliRunner

from geoaim.cli import app

run = CliRunner().invoke
command = import_module("geoaim.cli.testing")  # the package has the command under this name
SAMPLES = Path(__file__).parents[2] / "samples"


def read_files(folder: Path) -> dict[str, bytes]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def test_written_recording_is_the_bundled_one(tmp_path):
    result = run(app, ["sample", str(tmp_path / "place")])
    assert result.exit_code == 0, result.output
    assert read_files(tmp_path / "place") == read_files(SAMPLES)


def test_package_leads_to_the_recording_of_the_checkout():
    assert command.find_sample() == SAMPLES


def test_sample_is_not_written_into_a_folder_with_other_files(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    result = run(app, ["sample", str(tmp_path)])
    assert result.exit_code == 1
    assert "holds thesis.tex; name a new folder" in " ".join(result.output.split())
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_package_without_the_recording_says_so_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(command, "PACKAGE", tmp_path / "geoaim")
    result = run(app, ["sample", str(tmp_path / "place")])
    assert result.exit_code == 1
    assert "install geoaim again" in " ".join(result.output.split())
    assert not (tmp_path / "place").exists()
