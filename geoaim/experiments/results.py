"""What experiments leave behind: a small JSON file and a Markdown table of each."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from geoaim.bench.report import machine, write_json
from geoaim.files import replacing
from geoaim.prediction.report import Summary, markdown

FOLDER = Path("docs/experiments")


def write_results(name: str, tables: Mapping[str, Summary], about: Mapping[str, Any]) -> list[Path]:
    """Write means with their intervals, and what they are of; the files."""
    content = {
        "command": f"geoaim experiment {name}",
        "machine": machine(),
        **about,
        "methods": {key: dict(table) for key, table in tables.items()},
    }
    paths = [FOLDER / f"{name}.json", FOLDER / f"{name}.md"]
    write_json(content, paths[0])
    with replacing(paths[1]) as temporary:
        text = f"`geoaim experiment {name}`\n\n{markdown(tables)}\n"
        temporary.write_text(text, encoding="utf-8")
    return paths
