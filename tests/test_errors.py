import inspect
from pathlib import Path

import pytest

from geoaim.errors import GeoaimWarning, warn
from geoaim.progress import report_each


def test_warning_names_the_line_that_called_the_package():
    names = {"__name__": "geoaim.tracks", "warn": inspect.unwrap(warn)}  # without checks of shapes
    exec("def inner(): warn('2 rows')\ndef outer(): inner()", names)
    with pytest.warns(GeoaimWarning, match="2 rows") as caught:
        names["outer"]()
    assert Path(caught[0].filename) == Path(__file__)


def test_items_are_reported_as_they_are_yielded():
    calls = []
    items = report_each("ab", lambda *call: calls.append(call), "letters", 2)
    assert next(items) == "a"
    assert calls == [("letters", 1, 2)]
    assert list(items) == ["b"]
    assert calls[-1] == ("letters", 2, 2)
