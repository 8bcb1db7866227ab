"""Measures as tables for people."""

from collections.abc import Mapping

Summary = Mapping[str, Mapping[str, float]]


def markdown(found: Mapping[str, Summary]) -> str:
    """A row for each method, a column for each measure, with its interval of 95 %.

    >>> print(markdown({"a": {"minADE": {"mean": 1.0, "low": 0.9, "high": 1.1}}}))
    | | minADE |
    | --- | --- |
    | a | 1 (0.9 to 1.1) |
    """
    names = list(dict.fromkeys(name for summary in found.values() for name in summary))
    lines = ["| | " + " | ".join(names) + " |", "|" + " --- |" * (len(names) + 1)]
    for method, summary in found.items():
        cells = [_cell(summary[name]) if name in summary else "" for name in names]
        lines.append(f"| {method} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(value: Mapping[str, float]) -> str:
    return f"{value['mean']:.3g} ({value['low']:.3g} to {value['high']:.3g})"
