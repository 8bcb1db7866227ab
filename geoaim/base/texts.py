"""Texts from files, such as names of agents, for terminals, plots and tables: nothing acts."""

import re
import unicodedata
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

HIDDEN = {"Cc", "Cf", "Cs", "Zl", "Zp"}  # categories of Unicode: control, direction, line breaks
FORMULA = re.compile(r"'*[=+\-@\t\r](?!\d*\.?\d*$)")  # by which a spreadsheet takes a text for one


def show_text(text: str) -> str:
    r"""Write control characters and marks of direction as their codes; lines stay lines.

    >>> show_text("a\x1b[2J b")
    'a\\x1b[2J b'
    """
    return "".join(
        c if c == "\n" or unicodedata.category(c) not in HIDDEN else ascii(c)[1:-1] for c in text
    )


def plot_text(text: str) -> str:
    r"""Write a text for matplotlib, which takes what is between dollar signs for mathematics.

    >>> plot_text("$x$")
    '\\$x\\$'
    """
    return show_text(text).replace("$", r"\$")


def hide_credentials(text: str) -> str:
    """Leave user names and passwords out of the addresses in a text.

    >>> hide_credentials("https://user:password@host/tiles")
    'https://host/tiles'
    """
    return re.sub(r"(?<=://)[^/\s@]*@", "", text)


def mark_formulas(names: "pd.Series[str]") -> "pd.Series[str]":
    """Put an apostrophe before names that a spreadsheet would take for formulas."""
    return names.map(lambda name: f"'{name}" if FORMULA.match(name) else name)


def unmark_formulas(names: "pd.Series[str]") -> "pd.Series[str]":
    """Take away what `mark_formulas` put before names."""
    return names.map(
        lambda name: name[1:] if name.startswith("'") and FORMULA.match(name) else name
    )
