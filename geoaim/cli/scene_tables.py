"""Read a table of scenes: recordings of any places, on which a model is trained."""

import csv
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from geoaim.base.csv_rows import parse_number, read_rows
from geoaim.base.errors import TracksError
from geoaim.base.progress import Progress
from geoaim.cli.inputs import SceneSource, read_scene

if TYPE_CHECKING:
    from geoaim.rendering.ground import Ground
    from geoaim.rendering.scene import Scene

COLUMNS = tuple(field.name for field in fields(SceneSource))
NEEDED = ("aim", "tracks")
FILES = ("aim", "tracks", "lights", "hdmap", "stop_lines")
NUMBERS = ("tracks_resolution", "tracks_frame_rate")


def read_scene_sources(path: Path) -> list[SceneSource]:
    """Read a CSV with the columns `aim` and `tracks`, and other fields of `SceneSource`."""
    with open(path, encoding="utf-8-sig", newline="") as file:
        try:
            header, rows = read_rows(file)
        except (ValueError, csv.Error) as error:
            raise TracksError(f"{path} is not a CSV of recordings: {error}") from error
    if not set(NEEDED) <= set(header) <= set(COLUMNS) or len(set(header)) < len(header):
        raise TracksError(
            f"{path} has the columns {', '.join(header)}; needed are {' and '.join(NEEDED)}, "
            f"allowed are {', '.join(COLUMNS)}, each once"
        )
    if not rows:
        raise TracksError(f"{path} has no rows; give one for each recording")
    sources = []
    for number, cells in rows:
        try:
            sources.append(_parse_row(cells, path.parent))
        except ValueError as error:
            raise TracksError(f"{path}, line {number}: {error}") from error
    return sources


def read_scenes(sources: list[SceneSource], rate: float, progress: Progress) -> list["Scene"]:
    """Read scenes; those of one map share its ground, so that it is kept once."""
    grounds: dict[Path, Ground] = {}
    scenes = []
    for number, source in enumerate(sources):
        progress("read", number, len(sources))
        scene, _, _ = read_scene(source, rate=rate)
        scenes.append(replace(scene, ground=grounds.setdefault(source.aim.resolve(), scene.ground)))
    progress("read", len(sources), len(sources))
    return scenes


def _parse_row(cells: Mapping[str, str], folder: Path) -> SceneSource:
    missing = [name for name in NEEDED if name not in cells]
    if missing:
        raise ValueError(f"it names no {missing[0]}")
    files = {name: folder / cells[name] for name in FILES if name in cells}
    numbers = {name: parse_number(name, cells[name]) for name in NUMBERS if name in cells}
    return SceneSource(
        files["aim"],
        files["tracks"],
        cells.get("tracks_world"),
        numbers.get("tracks_resolution"),
        numbers.get("tracks_frame_rate"),
        files.get("lights"),
        files.get("hdmap"),
        files.get("stop_lines"),
    )
