"""Names from files act nowhere."""

from io import StringIO

import pandas as pd
import pytest
from matplotlib.figure import Figure

from geoaim.base.files import write_figure
from geoaim.base.map_axes import add_legend, draw_lines, label_place
from geoaim.base.texts import mark_formulas, show_text, unmark_formulas
from geoaim.base.world import World
from geoaim.cli import console
from geoaim.tracks.files import read_plain_tracks, write_tracks
from geoaim.tracks.tables import make_tracks

HOSTILE = [
    r"$\frac{$",
    "$x$",
    "a\x1b[2J",
    "a\u202eb",
    "a\rb",
    "a\nb",
    "=1+1",
    "'=1+1",
    "-1",
    "-x",
    "@x",
    "\tx",
    'a"b,c',
    "NA",
    "",
    " a ",
    "#a",
]


def test_control_characters_are_shown_as_their_codes():
    assert show_text("a\x1b[2J\u202e") == r"a\x1b[2J\u202e"


def test_names_that_look_like_formulas_are_marked_and_come_back():
    names = pd.Series(["=1+1", "'=x", "-1", "-1.5", "-x", "@a", "a", "'a"])
    marked = mark_formulas(names)
    assert list(marked) == ["'=1+1", "''=x", "-1", "-1.5", "'-x", "'@a", "a", "'a"]
    assert list(unmark_formulas(marked)) == list(names)


def test_dollar_signs_are_no_mathematics(tmp_path):
    figure = Figure()
    axes = figure.subplots()
    axes.set_title(HOSTILE[0])
    label_place(axes, HOSTILE[0], pd.Series([0.0, 0.0]).to_numpy())
    draw_lines(axes, [], "red", label=HOSTILE[1])
    add_legend(axes)
    write_figure(figure, tmp_path / "a.png")
    assert (tmp_path / "a.png").exists()


def test_the_terminal_gets_no_control_characters(monkeypatch):
    file = StringIO()
    monkeypatch.setattr(console, "console", type(console.console)(file=file))
    console.print_table("a\x1b[2Jb", {"\u202ename": "\x1b]0;title\x07"})
    assert not {"\x1b", "\u202e", "\x07"} & set(file.getvalue())


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_hostile_ids_and_types_are_written_and_read(tmp_path, suffix):
    names = [name for name in HOSTILE if name]
    state = {"x": 1.0, "y": 2.0, "heading": 0.0, "speed": 1.0, "length": 4.0, "width": 2.0}
    rows = [
        {"id": name, "type": name, "time": time, **state} for name in names for time in (0.0, 0.1)
    ]
    tracks = make_tracks(pd.DataFrame(rows), World(None))
    write_tracks(tracks, tmp_path / f"a{suffix}")
    again = read_plain_tracks(tmp_path / f"a{suffix}")
    assert again.ids == tracks.ids
    assert again.types == tracks.types
