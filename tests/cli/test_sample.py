from typing import get_args

from typer.testing import CliRunner

from geoaim.cli import app
from geoaim.cli.sample import PlaceKind
from geoaim.synthetic.roads.layouts import PLACE_KINDS

run = CliRunner().invoke


def test_sample_offers_every_kind_of_place():
    assert get_args(PlaceKind) == PLACE_KINDS


def test_sample_is_not_written_into_a_folder_with_other_files(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    result = run(app, ["sample", str(tmp_path)])
    assert result.exit_code == 1
    assert "holds thesis.tex; name a new folder" in " ".join(result.output.split())
