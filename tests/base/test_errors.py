import inspect
from pathlib import Path

import pytest

from geoaim.base.errors import GeoaimWarning, TracksError, warn
from geoaim.base.progress import report_each


def test_warning_names_the_line_that_called_the_package():
    names = {
        "__name__": "geoaim.tracks.tracks",
        "warn": inspect.unwrap(warn),
    }  # without checks of shapes
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


def test_message_is_one_line_without_control_characters():
    error = TracksError("a.csv lacks x; it has ,0x10\ngates,\x1b[31m\x85\r. Name x")
    assert str(error) == "a.csv lacks x; it has ,0x10 gates, [31m  . Name x"
    with pytest.warns(GeoaimWarning, match=r"^a\.csv: 1  2$"):
        warn("a.csv: 1\r\n2")


def test_long_message_keeps_its_begin_and_end():
    error = TracksError(f"a.csv has {200_000 * 'x'}; name it y")
    assert str(error).startswith("a.csv has xxx")
    assert str(error).endswith("xxx; name it y")
    assert len(str(error)) < 1100
