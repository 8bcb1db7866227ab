"""Records: what became of each recording, beside its map, and which of them are current."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from geoaim.base.errors import CatalogError
from geoaim.catalog.recordings import VERSION, InputFile, Recording
from geoaim.catalog.storage import (
    StoredFile,
    hash_bytes,
    join_address,
    list_tree,
    read_files,
    write_file,
)
from geoaim.mapping.build_map import MapSettings

FORMAT = 1
FOLDER = "recordings"  # folder of a catalogue that has a folder for each recording
RECORD = "record.json"
MAP = "aim.tif"
LOOK = "aim.png"
TRACKS = "tracks.parquet"
CHANGES = "changes.jpg"
ITEM = "item.json"
Status = Literal["built", "refused", "failed"]


@dataclass(frozen=True)
class OutputFile:
    """A file of a map, as it was written."""

    size: int
    sha256: str


@dataclass(frozen=True)
class Record:
    """What became of a recording.

    Attributes:
        name: name of the recording.
        status: built; refused, since its data give no map; failed for a reason outside of them,
            such as a store that cannot be reached, so that the next run tries again.
        reason: why it was refused or failed; empty if it was built.
        version: version of geoaim.
        settings: the options of its map.
        choices: place, imagery, near and tracks, as `Recording.list_choices` lists them.
        content_hash: hash of inputs, settings and version; empty where an input could not be read.
        inputs: the files from which it was built.
        input_hashes: SHA-256 of each.
        files: the files of the map by name.
        item: its STAC item.
        warnings: warnings that were given.
        report: report of the map, see `geoaim.AIM`.
        grid: grid of the map: CRS, shape and transform; and its corners in degrees, if it has a
            place.
        datetime: time at which it was recorded, ISO 8601, and where that is known from.
        started: time at which its build started, ISO 8601.
        seconds: duration of the build, and the processor time in it.
    """

    name: str
    status: Status
    reason: str
    version: str
    settings: MapSettings
    choices: Mapping[str, str] = field(default_factory=dict)
    content_hash: str = ""
    inputs: Sequence[InputFile] = ()
    input_hashes: Sequence[str] = ()
    files: Mapping[str, OutputFile] = field(default_factory=dict)
    item: OutputFile | None = None
    warnings: Sequence[str] = ()
    report: Mapping[str, Any] = field(default_factory=dict)
    grid: Mapping[str, Any] = field(default_factory=dict)
    datetime: str | None = None
    datetime_source: str = ""
    started: str = ""
    seconds: float = 0.0
    processor_seconds: float = 0.0


def list_files(record: Record) -> dict[str, OutputFile]:
    """List the files beside a record: its map and the STAC item, by name."""
    return dict(record.files) | ({ITEM: record.item} if record.item else {})


def format_record(record: Record) -> bytes:
    """Format a record as JSON, with a checksum of its values."""
    values = json.loads(json.dumps({"format": FORMAT, **asdict(record)}, allow_nan=False))
    return json.dumps(values | {"checksum": _compute_checksum(values)}, indent=1).encode()


def parse_record(content: bytes, address: str) -> Record:
    """Parse a record."""
    try:
        values = json.loads(content)
        checksum = values.pop("checksum", None)
        written = _compute_checksum(values)
        if values.pop("format") != FORMAT:
            raise CatalogError(f"{address} was written by a later version of geoaim; use that")
        if checksum != written:
            raise ValueError("its checksum is another one")
        values["settings"] = MapSettings(**values["settings"])
        values["inputs"] = tuple(InputFile(**file) for file in values["inputs"])
        values["files"] = {name: OutputFile(**file) for name, file in values["files"].items()}
        values["item"] = values["item"] and OutputFile(**values["item"])
        return Record(**values)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise CatalogError(
            f"{address} is not a record of a catalogue, or is damaged ({error}): remove it, and "
            "build the catalogue again"
        ) from error


def _compute_checksum(values: Mapping[str, Any]) -> str:
    return hash_bytes(json.dumps(values, sort_keys=True).encode())


def get_folder(catalog: str, name: str) -> str:
    """Get the address of the folder of a recording in a catalogue."""
    return join_address(catalog, FOLDER, name)


def write_record(record: Record, folder: str) -> None:
    """Write a record into the folder of its recording."""
    write_file(join_address(folder, RECORD), format_record(record))


def has_files(record: Record, sizes: Mapping[str, int]) -> bool:
    """Tell whether all files of a record's map are among files of given sizes, by name."""
    return all(sizes.get(name) == file.size for name, file in list_files(record).items())


def check_records(
    catalog: str, records: Mapping[str, Record], problems: Sequence[str] = ()
) -> None:
    """Check that `read_records` found a catalogue."""
    if not records and not problems:
        raise CatalogError(
            f"{catalog} holds no recordings; give the folder that `geoaim catalog build` wrote"
        )


def read_records(catalog: str) -> tuple[dict[str, Record], dict[str, StoredFile], list[str]]:
    """Read the records of a catalogue."""
    tree = list_tree(join_address(catalog, FOLDER))
    files = [file for path, file in sorted(tree.items()) if path.endswith(f"/{RECORD}")]
    records, problems = {}, []
    for file, content in zip(files, read_files([file.address for file in files]), strict=True):
        try:
            record = parse_record(content, file.address)
        except CatalogError as error:
            problems.append(str(error))
        else:
            records[record.name] = record
    return records, tree, problems


def is_current(
    record: Record,
    recording: Recording,
    inputs: Sequence[InputFile],
    tree: Mapping[str, StoredFile],
) -> bool:
    """Tell, without reading any file, whether a recording needs no new build."""
    paths = {name: f"{record.name}/{name}" for name in list_files(record)}
    sizes = {name: tree[path].size for name, path in paths.items() if path in tree}
    return (
        record.status != "failed"
        and record.version == VERSION
        and record.settings == recording.settings
        and record.choices == recording.list_choices()
        and tuple(record.inputs) == tuple(inputs)
        and has_files(record, sizes)
    )
