"""Build a catalogue: what is new or changed is built, then the index and the report are written."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from os import PathLike

from geoaim.base.errors import CatalogError, warn
from geoaim.catalog.building import Task, make_record, make_task
from geoaim.catalog.engine import Cluster, RecordingProgress, run_tasks
from geoaim.catalog.recordings import InputFile, Recording, list_inputs, read_recordings
from geoaim.catalog.records import (
    MAP,
    Record,
    check_records,
    get_folder,
    is_current,
    read_records,
    write_record,
)
from geoaim.catalog.storage import StoredFile, check_output, list_folder, make_address
from geoaim.catalog.verification import find_listing_problems, write_listing

Inputs = dict[str, tuple[InputFile, ...]]  # of recordings, by name


def list_all_inputs(
    recordings: Sequence[Recording], records: Mapping[str, Record]
) -> tuple[Inputs, list[Record]]:
    """List the files of all recordings, unread; with new records of those without any."""
    list_files = _make_lister()
    inputs, unlisted = dict[str, tuple[InputFile, ...]](), []
    for recording in recordings:
        earlier = records.get(recording.name)
        try:
            inputs[recording.name] = tuple(list_inputs(recording, list_files))
        except CatalogError as error:
            if earlier is None or earlier.reason != str(error):
                unlisted.append(make_record(recording, "refused", str(error)))
        except OSError as error:
            unlisted.append(make_record(recording, "failed", str(error)))
    return inputs, unlisted


@dataclass
class Plan:
    """What is left to do of a run.

    Attributes:
        address: address of the catalogue.
        inputs: files of each recording.
        places: the recordings of each place, those first whose own place is known best; a recording
            without a place is alone.
        tried: names of recordings that were built in this run as the first ones of their places,
            and of those that were then registered to the first one.
    """

    address: str
    inputs: Inputs
    places: Sequence[Sequence[Recording]]
    tried: tuple[set[str], set[str]] = field(default_factory=lambda: (set(), set()))

    def list_ready(
        self, records: Mapping[str, Record], tree: Mapping[str, StoredFile]
    ) -> list[Task]:
        """List the tasks that can be done now, the largest first; none where all is done."""
        tasks = [task for rows in self.places for task in self._list_of_place(rows, records, tree)]
        return sorted(tasks, key=lambda task: -sum(file.size for file in task.inputs))

    def _list_of_place(
        self,
        rows: Sequence[Recording],
        records: Mapping[str, Record],
        tree: Mapping[str, StoredFile],
    ) -> list[Task]:
        current = {
            row.name: record
            for row in rows
            if (record := records.get(row.name)) is not None
            and is_current(record, row, self.inputs[row.name], tree)
        }
        built = [name for name, record in current.items() if record.status == "built"]
        if built:  # the one that was registered to no other: its inputs have no reference
            return self._list_others(rows, built[0], records, tree)
        for row in rows:  # until one gives a map
            if row.name not in current and row.name not in self.tried[0]:
                self.tried[0].add(row.name)
                return [make_task(row, self.inputs[row.name], self.address)]
        return []

    def _list_others(
        self,
        rows: Sequence[Recording],
        reference: str,
        records: Mapping[str, Record],
        tree: Mapping[str, StoredFile],
    ) -> list[Task]:
        tasks = []
        stored = tree[f"{reference}/{MAP}"]
        first = InputFile("reference", MAP, stored.address, stored.size, stored.stamp)
        for row in rows:
            inputs = (*self.inputs[row.name], first)
            earlier = records.get(row.name)
            if row.name in self.tried[1] | {reference}:
                continue
            if earlier is None or not is_current(earlier, row, inputs, tree):
                self.tried[1].add(row.name)
                tasks.append(make_task(row, inputs, self.address, reference))
        return tasks


def make_plan(recordings: Sequence[Recording], inputs: Inputs, address: str) -> Plan:
    """Plan a run: the recordings whose files are known, by their places."""
    places: dict[str, list[Recording]] = {}
    for row in recordings:
        if row.name in inputs:
            key = f"/{row.name}" if row.place is None else row.place  # no name has a slash
            places.setdefault(key, []).append(row)
    for rows in places.values():
        rows.sort(key=lambda row: _rank(row, inputs[row.name]))
    return Plan(address, inputs, list(places.values()))


def _rank(recording: Recording, inputs: Sequence[InputFile]) -> int:
    """How well the place of a recording is known by itself; 0 is best."""
    roles = {file.role for file in inputs}
    known = ("gcps" in roles, recording.imagery is not None, "telemetry" in roles)
    return known.index(True) if any(known) else len(known)


def _make_lister() -> Callable[[str], dict[str, StoredFile]]:
    """A function that lists each folder once for many recordings, one that fails too."""

    @cache
    def try_folder(folder: str) -> dict[str, StoredFile] | OSError:
        try:
            return list_folder(folder)
        except OSError as error:
            return error

    def list_files(folder: str) -> dict[str, StoredFile]:
        found = try_folder(folder)
        if isinstance(found, OSError):
            raise found
        return found

    return list_files


@dataclass(frozen=True)
class Catalog:
    """The maps of many recordings, with what became of each.

    Attributes:
        address: address of its folder.
        records: records of the recordings, by name.
        built_now: names of those that this run built, refused or failed to build.
    """

    address: str
    records: Mapping[str, Record]
    built_now: Sequence[str] = ()

    def list_by_status(self, status: str) -> list[Record]:
        """List the records that are "built", "refused" or "failed", by name."""
        return [record for _, record in sorted(self.records.items()) if record.status == status]


def build_catalog(
    recordings: str | PathLike[str] | Sequence[Recording],
    catalog: str | PathLike[str],
    *,
    cluster: Cluster | None = None,
    progress: RecordingProgress = lambda name, stage, done, total: None,
    finished: Callable[[Record, int], None] = lambda record, left: None,
) -> Catalog:
    """Build the maps of many recordings on the workers of a cluster.

    A recording whose map is there, from the same files, settings and version, is not built again.
    One whose data give no map is refused with the reason, and the others go on. A script that
    starts workers of this machine needs `if __name__ == "__main__":`, as all that starts processes.

    Args:
        recordings: a table as `read_recordings` reads it, or recordings.
        catalog: path or address of its folder.
        cluster: the workers; None: one for each core of this machine.
        progress: called while a recording is built: its name, stage, frames done, frames in all.
        finished: called with each new record and the number of recordings that are left.

    Returns:
        The catalogue, with all of its records.

    Raises:
        CatalogError: the table cannot be read, or the scheduler cannot be reached.
        OSError: the catalogue cannot be read or written.
    """
    if isinstance(recordings, str | PathLike):
        recordings = read_recordings(recordings)
    address = make_address(catalog)
    records, tree, problems = read_records(address)
    for problem in problems:
        warn(problem)
    inputs, unlisted = list_all_inputs(recordings, records)
    plan = make_plan(recordings, inputs, address)
    tasks = plan.list_ready(records, tree)
    if tasks or unlisted:
        check_output(address)
    new = {record.name: record for record in unlisted}
    left = len(tasks)
    for record in unlisted:
        finished(record, left)
        earlier = records.get(record.name)
        # a store that does not answer takes no map away
        if record.status == "refused" or earlier is None or earlier.status != "built":
            write_record(record, get_folder(address, record.name))
    if unlisted and not tasks:  # what is built reads them anew below
        records = read_records(address)[0]
    while tasks:
        left = len(tasks)
        for record in run_tasks(tasks, cluster or Cluster(), progress):
            left -= 1
            new[record.name] = record
            finished(record, left)
            if record.status == "failed":
                with suppress(OSError):  # the store may be what failed; the next run tries again
                    write_record(record, get_folder(address, record.name))
        # another run may have written records too; those of failures may not be there
        records, tree, _ = read_records(address)
        tasks = plan.list_ready(records, tree)
    if find_listing_problems(list(records.values()), address):
        write_listing(list(records.values()), address)
    return Catalog(address, dict(sorted({**records, **new}.items())), tuple(new))


def read_catalog(catalog: str | PathLike[str]) -> Catalog:
    """Read the records of a catalogue.

    Args:
        catalog: path or address of its folder.

    Returns:
        The catalogue. Records that cannot be read are left out, with a warning.

    Raises:
        CatalogError: there is no record.
        OSError: it cannot be read.
    """
    address = make_address(catalog)
    records, _, problems = read_records(address)
    for problem in problems:
        warn(problem)
    check_records(address, records)
    return Catalog(address, records)
