"""The files of a catalogue that list all maps: index, report, and checksums of every file."""

from collections.abc import Sequence

from geoaim.catalog.problems import CHECKSUM_DIFFERS, Problem
from geoaim.catalog.records import FOLDER, RECORD, Record, format_record, list_files
from geoaim.catalog.report import PAGE, REPORT, format_report
from geoaim.catalog.stac import COLLECTION, INDEX, format_index
from geoaim.catalog.storage import (
    hash_bytes,
    join_address,
    list_folder,
    read_files,
    remove_file,
    write_file,
)

CHECKSUMS = "checksums.sha256"  # as `sha256sum` writes and checks them


def write_listing(records: Sequence[Record], catalog: str) -> None:
    """Write index, report and checksums.

    Args:
        records: all records of the catalogue.
        catalog: its address.
    """
    contents = format_index(records) | format_report(records)
    if INDEX not in contents:
        remove_file(join_address(catalog, INDEX))
    for name, content in contents.items():
        write_file(join_address(catalog, name), content)
    sums = {name: hash_bytes(content) for name, content in contents.items()} | _list_sums(records)
    lines = [f"{digest}  {path}\n" for path, digest in sorted(sums.items())]
    write_file(join_address(catalog, CHECKSUMS), "".join(lines).encode())


def find_listing_problems(records: Sequence[Record], catalog: str) -> list[Problem]:
    """Find what is wrong with index, report and checksums.

    Args:
        records: all records of the catalogue.
        catalog: its address.

    Returns:
        What was found; nothing where all are as they were written, from these records.
    """
    stored = list_folder(catalog)
    names = [COLLECTION, REPORT, PAGE, CHECKSUMS]
    if any(record.grid.get("corners_lonlat") for record in records):
        names.append(INDEX)
    problems = [Problem(name, "missing") for name in names if name not in stored]
    if CHECKSUMS not in stored:
        return problems
    here = [name for name in names if name in stored]
    contents = dict(zip(here, read_files([stored[name].address for name in here]), strict=True))
    sums = _parse_checksums(contents.pop(CHECKSUMS))
    for name, content in contents.items():
        if sums.get(name) != hash_bytes(content):
            problems.append(Problem(name, CHECKSUM_DIFFERS, is_changed=True))
    if {path: digest for path, digest in sums.items() if "/" in path} != _list_sums(records):
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
