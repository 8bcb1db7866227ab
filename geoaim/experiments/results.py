"""What experiments leave behind: a small JSON file and a Markdown table of each."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from geoaim.bench.report import describe_machine, write_json
from geoaim.files import atomic_write
from geoaim.prediction.metrics import Measure, interval, summary
from geoaim.prediction.report import markdown

FOLDER = Path("docs/experiments")
Measures = Mapping[str, Measure]


def write_results(name: str, found: Mapping[str, Measures], about: Mapping[str, Any]) -> list[Path]:
    """Write means with their intervals of all methods, and what they are of; the files."""
    tables = {method: summary(measures) for method, measures in found.items()}
    content = {
        "command": f"geoaim experiment {name}",
        "machine": describe_machine(),
        **about,
        "methods": tables,
    }
    paths = [FOLDER / f"{name}.json", FOLDER / f"{name}.md"]
    write_json(content, paths[0])
    with atomic_write(paths[1]) as temporary:
        text = f"`geoaim experiment {name}`\n\n{markdown(tables)}\n"
        temporary.write_text(text, encoding="utf-8")
    return paths


def means(trainings: Sequence[Measures]) -> list[dict[str, float]]:
    """What each training of a model comes to: how far chance goes."""
    return [{name: measure.mean for name, measure in one.items()} for one in trainings]


def differences(one: Measures, other: Measures) -> dict[str, tuple[float, float]]:
    """One method's measures less another's on the same segments, as intervals of 95 %."""
    return {name: interval(one[name], other[name]) for name in one if name in other}
