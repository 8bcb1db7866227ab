"""Read the records of a catalogue, and tell which of them are current."""

from collections.abc import Mapping, Sequence

from geoaim.base.errors import CatalogError
from geoaim.catalog.inputs import VERSION, InputFile
from geoaim.catalog.recordings import Recording
from geoaim.catalog.records import FOLDER, RECORD, Record, format_record, list_files, parse_record
from geoaim.catalog.storage import StoredFile, join_address, list_tree, read_files, write_file


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
    """Check that `read_records` found a catalogue.

    Args:
        catalog: its address.
        records: the records that were found.
        problems: the messages about records that cannot be read.

    Raises:
        CatalogError: it found nothing.
    """
    if not records and not problems:
        raise CatalogError(
            f"{catalog} holds no recordings; give the folder that `geoaim catalog build` wrote"
        )


def read_records(catalog: str) -> tuple[dict[str, Record], dict[str, StoredFile], list[str]]:
    """Read the records of a catalogue.

    Args:
        catalog: its address.

    Returns:
        The records by name; all files of recordings, by their paths below `FOLDER`; and the
        messages about records that cannot be read.
    """
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
    """Tell, without reading any file, whether a recording needs no new build.

    Args:
        record: the record of an earlier build.
        recording: the recording as it is requested now.
        inputs: its files as they are listed now.
        tree: the files of the catalogue, by their paths below `FOLDER`.

    Returns:
        Whether the record was made by this version from the same inputs and settings, and the
        files of its map are there with their sizes. A recording that failed is never current.
    """
    paths = {name: f"{record.name}/{name}" for name in list_files(record)}
    sizes = {name: tree[path].size for name, path in paths.items() if path in tree}
    return (
        record.status != "failed"
        and record.version == VERSION
        and record.settings == recording.settings
        and tuple(record.inputs) == tuple(inputs)
        and has_files(record, sizes)
    )
