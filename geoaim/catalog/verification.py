"""Verify a catalogue: read all its files, and find what is missing or changed."""

from collections.abc import Iterable, Iterator
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory

from geoaim.catalog.listing import find_listing_problems
from geoaim.catalog.problems import CHECKSUM_DIFFERS, Problem
from geoaim.catalog.record_files import check_records, read_records
from geoaim.catalog.records import FOLDER, RECORD, OutputFile, Record, list_files
from geoaim.catalog.storage import (
    StoredFile,
    download,
    hash_file,
    join_address,
    make_address,
    remove_file,
)


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
