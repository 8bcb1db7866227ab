"""Plan a run: which recordings of a catalogue have to be built."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from geoaim.base.errors import CatalogError
from geoaim.catalog.building import Task, make_record, make_task
from geoaim.catalog.inputs import list_inputs
from geoaim.catalog.record_files import is_current
from geoaim.catalog.recordings import Recording
from geoaim.catalog.records import Record
from geoaim.catalog.storage import StoredFile, list_folder


@dataclass(frozen=True)
class RunPlan:
    """What a run has to do.

    Attributes:
        tasks: recordings to build, the largest first.
        unlisted: records of recordings whose files do not exist (refused) or cannot be listed
            (failed).
    """

    tasks: Sequence[Task] = ()
    unlisted: Sequence[Record] = ()


def plan_run(
    recordings: Sequence[Recording],
    address: str,
    records: Mapping[str, Record],
    tree: Mapping[str, StoredFile],
) -> RunPlan:
    """Find what has to be built; files are listed, not read.

    Args:
        recordings: all that the catalogue should have.
        address: address of the catalogue.
        records: records of earlier runs, by name.
        tree: the files of the recordings in the catalogue, as `read_records` lists them.

    Returns:
        The plan.
    """
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
