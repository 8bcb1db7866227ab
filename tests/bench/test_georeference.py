import sys

import pytest

from geoaim.bench import georeference
from geoaim.bench.georeference import Cell, _run_outliers, run_cell


def test_a_cell_counts_each_trial_once():
    row = run_cell(Cell("spread", "tilt 4 deg", 6), trials=3)
    assert row["error_px"].keys() == {"chosen", *georeference.TERM_COUNTS, "AICc", "GRIC"}
    assert sum(n for model, n in row["models"].items() if model != "dropped") == 3


@pytest.mark.filterwarnings("ignore::geoaim.errors.GeoaimWarning")
def test_a_gross_outlier_is_found():
    row = _run_outliers(Cell("spread", "similarity", 8), 1e4, trials=1)
    assert row["outcomes"] == {"found": 1}


def test_the_command_explains_itself(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["georeference", "--help"])
    with pytest.raises(SystemExit, match="0"):
        georeference.main()
    assert "--trials" in capsys.readouterr().out
