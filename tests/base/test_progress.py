import sys
from types import SimpleNamespace

import pytest

from geoaim.base.progress import no_progress, notebook_progress, report_each


@pytest.fixture
def shown(monkeypatch) -> list[str]:
    """What a notebook is given to show below its cell."""
    IPython = pytest.importorskip("IPython")
    pictures = []

    def record(html, display_id=False):
        pictures.append(html.data)
        return SimpleNamespace(update=record)

    shell = SimpleNamespace(kernel=object(), execution_count=len(pictures) + 7)
    monkeypatch.setattr(IPython, "get_ipython", lambda: shell)
    monkeypatch.setattr("geoaim.base.progress._cells", {})  # no cell of another test
    monkeypatch.setattr("IPython.display.display", record)
    return pictures


def test_bars_of_a_cell_are_one_display_and_a_finished_stage_is_full(shown):
    for count in range(1, 5):
        notebook_progress("register", count, 4)
    notebook_progress("<b>", 1, None)
    assert 'value="4" max="4"></progress> register: 4 of 4' in shown[-1]
    assert "&lt;b&gt;: 1<br>" in shown[-1]
    assert len(shown) < 6


def test_a_stage_that_ended_before_its_total_does_not_seem_to_have_stopped(shown):
    for count in range(1, 33):
        notebook_progress("register", count, 64)
    notebook_progress("average", 1, 64)
    assert 'value="64" max="64"></progress> register: 32<br>' in shown[-1]


def test_nothing_is_shown_outside_notebooks(monkeypatch, capsys):
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    notebook_progress("register", 1, 2)
    assert list(report_each("ab", no_progress, "letters", 2)) == ["a", "b"]
    assert capsys.readouterr().out == ""
