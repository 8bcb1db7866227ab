"""Build a catalogue: what is new or changed is built, then the index and the report are written."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from os import PathLike

from geoaim.base.errors import CatalogError, warn
from geoaim.catalog.building import Task, make_record, make_task
from geoaim.catalog.engine import Cluster, RecordingProgress, run_tasks
from geoaim.catalog.recordings import Recording, list_inputs, read_recordings
from geoaim.catalog.records import (
    Record,
    check_records,
    get_folder,
    is_current,
    read_records,
    write_record,
)
from geoaim.catalog.storage import StoredFile, check_output, list_folder, make_address
from geoaim.catalog.verification import find_listing_problems, write_listing


@dataclass(frozen=True)
class RunPlan:
    """What a run has to do."""

    tasks: Sequence[Task] = ()
    unlisted: Sequence[Record] = ()


def plan_run(
    recordings: Sequence[Recording],
    address: str,
    records: Mapping[str, Record],
    tree: Mapping[str, StoredFile],
) -> RunPlan:
    """Find what has to be built; files are listed, not read."""
    list_files = _make_lister()
    tasks, unlisted = [], []
    for recording in recordings:
        earlier = records.get(recording.name)
        try:
            inputs = list_inputs(recording, list_files)
        except CatalogError as error:
            if earlier is None or earlier.reason != str(error):
                unlisted.append(make_record(recording, "refused", str(error)))
            continue
        except OSError as error:
            unlisted.append(make_record(recording, "failed", str(error)))
            continue
        if earlier is None or not is_current(earlier, recording, inputs, tree):
            tasks.append(make_task(recording, inputs, address))
    tasks.sort(key=lambda task: -sum(file.size for file in task.inputs))
    return RunPlan(tuple(tasks), tuple(unlisted))


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
    plan = plan_run(recordings, address, records, tree)
    if plan.tasks or plan.unlisted:
        check_output(address)
    new = {record.name: record for record in plan.unlisted}
    left = len(plan.tasks)
    for record in plan.unlisted:
        finished(record, left)
        earlier = records.get(record.name)
        # a store that does not answer takes no map away
        if record.status == "refused" or earlier is None or earlier.status != "built":
            write_record(record, get_folder(address, record.name))
    if plan.tasks:
        for record in run_tasks(plan.tasks, cluster or Cluster(), progress):
            left -= 1
            new[record.name] = record
            finished(record, left)
            if record.status == "failed":
                with suppress(OSError):  # the store may be what failed; the next run tries again
                    write_record(record, get_folder(address, record.name))
    if new:  # another run may have written records too
        records = read_records(address)[0]
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
