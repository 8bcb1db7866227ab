"""Shows the comments beside a class's fields as its attributes, where its docstring has none."""

import re
from typing import Any

import griffe

COMMENT = re.compile(r"^    (?:\w+: .*  )?# (.*)$")


class FieldComments(griffe.Extension):
    """Adds a section of attributes to the docstring of each class with commented fields."""

    def on_class(self, *, cls: griffe.Class, **kwargs: Any) -> None:
        """Append what the comments say."""
        if cls.docstring and "Attributes:" not in cls.docstring.value:
            fields = {name: _join_comments(a) for name, a in cls.attributes.items()}
            lines = [f"    {name}: {comment}" for name, comment in fields.items() if comment]
            if lines:
                cls.docstring.value += "\n\nAttributes:\n" + "\n".join(lines)


def _join_comments(field: griffe.Attribute) -> str:
    """Join the comment lines above a field and the comment beside it."""
    source, end = field.lines_collection[field.filepath], field.endlineno or 0
    start = end
    while start > 1 and source[start - 2].startswith("    # "):
        start -= 1
    matches = [COMMENT.match(line) for line in source[start - 1 : end]] if end else []
    return " ".join(match[1] for match in matches if match)
