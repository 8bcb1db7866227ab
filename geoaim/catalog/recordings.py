"""Recordings: the table of videos from which a catalogue is built, and the files of each."""

import csv
import json
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import datetime
from fnmatch import fnmatchcase
from importlib.metadata import version
from os import PathLike
from os.path import isdir
from pathlib import Path
from typing import Any

import fsspec

from geoaim.base.csv_rows import parse_number, read_rows
from geoaim.base.errors import CatalogError, name_option
from geoaim.base.texts import hide_credentials
from geoaim.catalog.storage import (
    StoredFile,
    download,
    get_local_path,
    get_name,
    get_store,
    hash_bytes,
    is_local,
    join_address,
    list_folder,
    make_address,
    report_storage,
    split_address,
)
from geoaim.imagery.alignment.place_by_imagery import parse_near
from geoaim.mapping.build_map import MapSettings
from geoaim.mapping.sampling import parse_frame_count
from geoaim.mapping.video.video import IMAGE_SUFFIXES

VERSION = version("geoaim")
SOURCES = ("video", "gcps", "detections", "imagery", "tracks", "hdmap")  # columns of addresses
ROLES = ("video", "telemetry", *SOURCES[1:], "reference")
TELEMETRY_SUFFIXES = (".SRT", ".srt")
ListFolder = Callable[[str], dict[str, StoredFile]]
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")  # a folder on every system, and part of a URL
MAX_LISTED_NAMES = 3  # names that a message lists
FROM_VIDEO = "video"  # in the column of tracks: they are made from the video
NUMBERS = ("resolution", "frame_resolution", "height", "yaw", "focal_length")


@dataclass(frozen=True)
class Recording:
    """A video and what places it: a row of the table.

    Attributes:
        name: name of the map in the catalogue.
        video: path or address of a video, or of a folder or glob of images.
        gcps: path or address of its control points; None: placed by telemetry or settings.
        detections: path or address of the folder of its boxes; None: it has none.
        datetime: time at which it was recorded, ISO 8601; None: the file's date.
        place: name of its place; all maps of a place lie in one world. None: it is for itself.
        imagery: path of an orthophoto or tiles, or address of a tile service, which place the map
            of a recording that is the first of its place or for itself; None: there is none.
        near: latitude and longitude of the frame's middle, degrees, which imagery needs where there
            is no telemetry.
        tracks: path or address of its tracks; "video": they are made from the video; None: none.
        hdmap: path or address of a lanelet2 map, whose lanes tell headings of standing vehicles.
        settings: the options of its map.
    """

    name: str
    video: str
    gcps: str | None = None
    detections: str | None = None
    datetime: str | None = None
    place: str | None = None
    imagery: str | None = None
    near: str | None = None
    tracks: str | None = None
    hdmap: str | None = None
    settings: MapSettings = field(default_factory=MapSettings)

    def list_choices(self) -> dict[str, str]:
        """List what is chosen beside files and settings: place, imagery, near, tracks."""
        values = {"place": self.place, "imagery": self.imagery, "near": self.near}
        values["tracks"] = FROM_VIDEO if self.tracks == FROM_VIDEO else None
        return {name: value for name, value in values.items() if value is not None}


COLUMNS = tuple(
    item.name for item in (*fields(Recording), *fields(MapSettings)) if item.name != "settings"
)


def read_recordings(source: str | PathLike[str], *, stores: Sequence[str] = ()) -> list[Recording]:
    """Read a table of recordings.

    Args:
        source: path or address of a CSV with the column `video` and, where needed, `name` (unique;
            the video's name if missing), the other attributes of `Recording` and the options of
            `MapSettings`. Paths are relative to the table's folder. An empty cell is as no column.
        stores: beginnings of addresses that cells may have, such as "s3://bucket/". A table in a
            store may name files of that store; others send no request.

    Returns:
        The recordings, in the table's order.

    Raises:
        CatalogError: the table cannot be read, has other columns, or a cell cannot be understood.
    """
    address = make_address(source)
    if isdir(address):
        raise CatalogError(f"{address} is a folder; a CSV of recordings is needed")
    with report_storage(address), fsspec.open(address, "rt", encoding="utf-8-sig") as file:
        try:
            header, rows = read_rows(file)
        except (ValueError, csv.Error) as error:
            raise CatalogError(f"{address} is not a CSV of recordings: {error}") from error
    is_unknown = not set(header) <= set(COLUMNS) or len(set(header)) < len(header)
    if is_unknown or "video" not in header:
        raise CatalogError(
            f"{address} has the columns {', '.join(header)}; needed is video, "
            f"allowed are {', '.join(COLUMNS)}, each once"
        )
    folder, _ = split_address(address)
    allowed = (*(f"{get_store(folder)}/",) * ("://" in folder), *stores)
    recordings = []
    for number, cells in rows:
        try:
            recordings.append(_parse_row(cells, folder, allowed))
        except ValueError as error:
            raise CatalogError(f"{address}, line {number}: {error}") from error
    _check_names(recordings, address)
    return recordings


def _parse_row(cells: Mapping[str, str], folder: str, stores: Sequence[str]) -> Recording:
    if "video" not in cells:
        raise ValueError("it names no video")
    addresses = {
        column: join_address(folder, cells[column])
        for column in SOURCES
        if column in cells and (column, cells[column]) != ("tracks", FROM_VIDEO)
    }
    for cell in addresses.values():
        if "::" in cell or ("://" in cell and not cell.startswith(tuple(stores))):
            raise ValueError(
                f"{hide_credentials(cell)} is in a store that you did not name; "
                + name_option(f"--store {get_store(cell)}/", f'stores=["{get_store(cell)}/"]')
                + " allows requests to it"
            )
    name = cells.get("name") or get_name(addresses["video"]).rsplit(".", 1)[0]
    for column, value in (("name", name), ("place", cells.get("place", name))):
        if not NAME.fullmatch(value):
            raise ValueError(
                f"the {column} {value!r} is not made of letters, digits, '.', '_' and '-'; give "
                f"another one in the column {column}"
            )
    if "datetime" in cells:
        datetime.fromisoformat(cells["datetime"])
    if "imagery" in cells and "gcps" in cells:
        raise ValueError("gcps and imagery both place the map; give one")
    if "near" in cells:
        parse_near(cells["near"])
    kept = {key: cells[key] for key in ("datetime", "place", "near", "tracks") if key in cells}
    return Recording(name=name, settings=_parse_settings(cells), **(kept | addresses))


def _parse_settings(cells: Mapping[str, str]) -> MapSettings:
    values: dict[str, Any] = {key: parse_number(key, cells[key]) for key in NUMBERS if key in cells}
    if "frames" in cells:
        values["frames"] = parse_frame_count(cells["frames"])
    if cells.get("frame_origin", "corner") not in ("corner", "middle"):
        raise ValueError(f"frame_origin is {cells['frame_origin']!r}; corner or middle is needed")
    values |= {key: cells[key] for key in ("crs", "frame_origin") if key in cells}
    return MapSettings(**values)


def _check_names(recordings: list[Recording], address: str) -> None:
    if not recordings:
        raise CatalogError(f"{address} has no recordings; needed is a row for each")
    counts = Counter(recording.name.lower() for recording in recordings)
    if twice := [name for name, count in counts.items() if count > 1]:
        first = ", ".join(twice[:MAX_LISTED_NAMES])
        raise CatalogError(
            f"{address} has {len(twice)} names more than once ({first}): give each recording a "
            "name of its own in the column name"
        )


@dataclass(frozen=True)
class InputFile:
    """A file from which a map is built."""

    role: str  # one of ROLES
    name: str  # name of the file
    address: str
    size: int
    stamp: str  # stamp, as in StoredFile


def list_inputs(recording: Recording, list_files: ListFolder = list_folder) -> list[InputFile]:
    """List the files of a recording, with the telemetry beside its video."""
    files = [("video", file) for file in _find_files(recording.video, list_files)]
    folder, name = split_address(recording.video)
    stem = name.rsplit(".", 1)[0]
    beside = list_files(folder)
    telemetry = (beside.get(stem + suffix) for suffix in TELEMETRY_SUFFIXES)
    files += [("telemetry", file) for file in telemetry if file and file.address != recording.video]
    for role in ("gcps", "detections", "tracks", "hdmap"):
        address = getattr(recording, role)
        if address is not None and address != FROM_VIDEO:
            files += [(role, file) for file in _find_files(address, list_files)]
    if recording.imagery is not None and "{" not in recording.imagery:  # else of a tile service
        folder, name = split_address(recording.imagery)
        if name in (beside := list_files(folder)):  # folders of tiles are not listed
            files.append(("imagery", beside[name]))
    return [
        InputFile(role, get_name(file.address), file.address, file.size, file.stamp)
        for role, file in files
    ]


def fetch_inputs(
    recording: Recording, inputs: Sequence[InputFile], folder: Path
) -> tuple[Recording, list[Path]]:
    """Copy the files that lie elsewhere to this machine."""
    paths = []
    for file in inputs:
        if is_local(file.address):
            paths.append(get_local_path(file.address))
            continue
        # telemetry is looked for beside the video
        path = folder / file.role.replace("telemetry", "video") / file.name
        download(file.address, path)
        paths.append(path)
    roles = {file.role for file in inputs}
    sources: dict[str, Any] = {
        role: _get_local_source(getattr(recording, role), role, inputs, folder)
        for role in SOURCES
        if role in roles
    }
    return replace(recording, **sources), paths


def _get_local_source(address: str, role: str, inputs: Sequence[InputFile], folder: Path) -> str:
    """The path of a file, folder or glob on this machine, after its files were copied."""
    if is_local(address):
        return str(get_local_path(address))
    names = get_name(address)
    is_folder = not any(file.address == address for file in inputs) and not _is_pattern(names)
    return str(folder / role if is_folder else folder / role / names)


def compute_content_hash(
    inputs: Sequence[InputFile], hashes: Sequence[str], recording: Recording
) -> str:
    """Compute what identifies a map: a hash of its inputs, its settings and geoaim's version."""
    files = [[file.role, file.name, digest] for file, digest in zip(inputs, hashes, strict=True)]
    content = {
        "version": VERSION,
        "settings": asdict(recording.settings),
        "choices": recording.list_choices(),
        "inputs": sorted(files),
    }
    return hash_bytes(json.dumps(content, sort_keys=True).encode())


def _find_files(address: str, list_files: ListFolder) -> list[StoredFile]:
    """A file, the images of a glob, or the files of a folder."""
    folder, name = split_address(address)
    beside = list_files(folder)
    if name in beside:
        return [beside[name]]
    if _is_pattern(name):
        files = [file for key, file in beside.items() if fnmatchcase(key, name)]
    else:
        files = [
            file
            for key, file in list_files(address).items()
            if f".{key.rsplit('.', 1)[-1].lower()}" in {*IMAGE_SUFFIXES, ".txt"}
        ]
    if not files:
        raise CatalogError(
            f"{address}: there is no such file, and no image or box in such a folder"
        )
    return sorted(files, key=lambda file: file.address)


def _is_pattern(name: str) -> bool:
    return any(sign in name for sign in "*?[")
