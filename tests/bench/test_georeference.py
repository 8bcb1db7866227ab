import pytest

from geoaim.bench.georeference import Cell, _run_outliers, run_cell


def test_a_cell_counts_each_trial_once():
    row = run_cell(Cell("spread", "tilt 4 deg", 6), trials=3)
    assert row["error_px"] > 0
    assert sum(n for model, n in row["models"].items() if model != "dropped") == 3


@pytest.mark.filterwarnings("ignore::geoaim.errors.GeoaimWarning")
def test_a_gross_outlier_is_found():
    row = _run_outliers(Cell("spread", "similarity", 8), 1e4, trials=1)
    assert row["outcomes"] == {"found": 1}
