from typer.testing import CliRunner

from geoaim.cli import app

run = CliRunner().invoke


def test_names_in_square_brackets_are_not_read_as_markup(tmp_path):
    result = run(app, ["info", str(tmp_path / "no[b]where[/b].tif")])
    assert result.exit_code == 1
    assert "no[b]where[/b].tif" in result.output.replace("\n", "")
