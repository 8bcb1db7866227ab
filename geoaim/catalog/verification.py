"""Files that list all maps, and verification: what is missing, changed, or belongs to nothing."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory

from geoaim.catalog.records import (
    FOLDER,
    RECORD,
    OutputFile,
    Record,
    check_records,
    format_record,
    list_files,
    read_records,
)
from geoaim.catalog.report import PAGE, REPORT, format_report
from geoaim.catalog.stac import COLLECTION, INDEX, format_index
from geoaim.catalog.storage import (
    StoredFile,
    download,
    hash_bytes,
    hash_file,
    join_address,
    list_folder,
    list_tree,
    make_address,
    read_files,
    remove_file,
    write_file,
)
from geoaim.catalog.tracks_of_days import PLACES, get_tracks_path, group_tracks, join_tracks

CHECKSUMS = "checksums.sha256"  # as `sha256sum` writes and checks them
CHECKSUM_DIFFERS = "changed: its checksum is another one"


@dataclass(frozen=True)
class Problem:
    """A file that is not as it was written."""

    path: str  # in the catalogue
    found: str  # what is wrong
    is_changed: bool = False  # whether its content is another one than was written


def write_listing(records: Sequence[Record], catalog: str) -> None:
    """Write index, report and checksums."""
    contents = format_index(records) | format_report(records) | join_tracks(records, catalog)
    if INDEX not in contents:
        remove_file(join_address(catalog, INDEX))
    for name, content in contents.items():
        write_file(join_address(catalog, name), content)
    sums = {name: hash_bytes(content) for name, content in contents.items()} | _list_sums(records)
    lines = [f"{digest}  {path}\n" for path, digest in sorted(sums.items())]
    write_file(join_address(catalog, CHECKSUMS), "".join(lines).encode())


def find_listing_problems(records: Sequence[Record], catalog: str) -> list[Problem]:
    """Find what is wrong with index, report and checksums."""
    stored = list_folder(catalog)
    names = [COLLECTION, REPORT, PAGE, CHECKSUMS]
    if any(record.grid.get("corners_lonlat") for record in records):
        names.append(INDEX)
    joined = list_tree(join_address(catalog, PLACES))
    stored |= {f"{PLACES}/{path}": file for path, file in joined.items()}
    names += [get_tracks_path(place) for place in group_tracks(records)]
    problems = [Problem(name, "missing") for name in names if name not in stored]
    if CHECKSUMS not in stored:
        return problems
    here = [name for name in names if name in stored]
    contents = dict(zip(here, read_files([stored[name].address for name in here]), strict=True))
    sums = _parse_checksums(contents.pop(CHECKSUMS))
    for name, content in contents.items():
        if sums.get(name) != hash_bytes(content):
            problems.append(Problem(name, CHECKSUM_DIFFERS, is_changed=True))
    of_records = {path: digest for path, digest in sums.items() if path.startswith(f"{FOLDER}/")}
    if of_records != _list_sums(records):
        problems.append(Problem(CHECKSUMS, "changed, or older than a record: they differ"))
    if INDEX in stored and INDEX not in names:
        problems.append(Problem(INDEX, "lists maps that are not there any more"))
    return problems


def _list_sums(records: Sequence[Record]) -> dict[str, str]:
    """The checksums of the files of all recordings, by their paths in the catalogue."""
    sums = {}
    for record in records:
        folder = f"{FOLDER}/{record.name}"
        sums[f"{folder}/{RECORD}"] = hash_bytes(format_record(record))
        sums |= {f"{folder}/{name}": file.sha256 for name, file in list_files(record).items()}
    return sums


def _parse_checksums(content: bytes) -> dict[str, str]:
    lines = content.decode(errors="replace").splitlines()
    return {path: digest for digest, _, path in (line.partition("  ") for line in lines)}


def verify_catalog(catalog: str | PathLike[str]) -> list[Problem]:
    """Compare all files of a catalogue with their sizes and checksums.

    Args:
        catalog: path or address of its folder.

    Returns:
        What is missing, changed or belongs to no record; none where all is as it was written.

    Raises:
        CatalogError: there is no catalogue.
        OSError: it cannot be read.
    """
    address = make_address(catalog)
    records, tree, messages = read_records(address)
    check_records(address, records, messages)
    problems = [Problem(FOLDER, message) for message in messages]
    for record in records.values():
        problems += _verify_record(record, tree)
    for path in tree:
        name, _, file = path.partition("/")
        is_listed = name in records and file in {RECORD, *list_files(records[name])}
        if not is_listed and not (file == RECORD and messages):
            problems.append(Problem(f"{FOLDER}/{path}", "belongs to no map that was built"))
    return problems + find_listing_problems(list(records.values()), address)


def remove_changed_files(catalog: str | PathLike[str], problems: Iterable[Problem]) -> None:
    """Remove the files that `verify_catalog` found changed, so that the next build makes them.

    Args:
        catalog: path or address of its folder.
        problems: what was found.
    """
    for problem in problems:
        if problem.is_changed:
            remove_file(join_address(make_address(catalog), problem.path))


def _verify_record(record: Record, tree: dict[str, StoredFile]) -> Iterator[Problem]:
    for name, file in list_files(record).items():
        path = f"{record.name}/{name}"
        found = "missing" if path not in tree else _compare(tree[path], file)
        if found:
            yield Problem(f"{FOLDER}/{path}", found, is_changed=path in tree)


def _compare(stored: StoredFile, written: OutputFile) -> str:
    if stored.size != written.size:
        return f"changed: {stored.size} bytes, {written.size} were written"
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        download(stored.address, copy)
        digest = hash_file(copy)
    return "" if digest == written.sha256 else CHECKSUM_DIFFERS
