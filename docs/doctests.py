"""Shows the examples of docstrings as code: a paragraph that begins with `>>>` gets a fence."""

import re
from typing import Any

import griffe

EXAMPLE = re.compile(r"^( *)(>>> .*(?:\n(?!\s*$).*)*)", flags=re.M)


class Doctests(griffe.Extension):
    """Puts doctests of every docstring into code blocks."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        """Fence the examples of one object's docstring."""
        if obj.docstring and ">>> " in obj.docstring.value:
            obj.docstring.value = EXAMPLE.sub(r"\1```pycon\n\1\2\n\1```", obj.docstring.value)
