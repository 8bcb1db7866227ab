"""Run the tasks of a catalogue on workers by Dask, through losses of workers and scheduler."""

import ast
import inspect
import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dask
from distributed import Client, KilledWorker, LocalCluster, as_completed, get_worker
from distributed.comm.core import CommClosedError

from geoaim.base.errors import CatalogError, warn
from geoaim.catalog.building import Task, build_recording, make_record
from geoaim.catalog.records import Record

TOPIC = "geoaim"  # topic of the events by which workers report their progress
MIN_INTERVAL_S = 0.5  # time between two events of one recording
CONNECT_S = 5.0  # time for one attempt to reach the scheduler
# called with a recording's name, its stage, the frames done and the frames in all
RecordingProgress = Callable[[str, str, float, float | None], None]


@dataclass(frozen=True)
class Cluster:
    """The workers that build a catalogue.

    Attributes:
        scheduler: address of a running Dask scheduler; None starts workers on this machine.
        workers: number of these; None: one for each core.
        memory_limit: memory of each worker, such as "4GB"; Dask stops a worker that uses more.
            "auto" shares the machine's memory.
        patience: seconds for which a scheduler may be out of reach.
    """

    scheduler: str | None = None
    workers: int | None = None
    memory_limit: str = "auto"
    patience: float = 300.0


def run_tasks(
    tasks: Sequence[Task], cluster: Cluster, progress: RecordingProgress
) -> Iterator[Record]:
    """Run tasks on workers, the first ones first."""
    waiting = {task.recording.name: task for task in tasks}
    lost_since = None
    with _start_workers(cluster) as address:
        while waiting:
            try:
                with _connect(address, progress) as client:
                    lost_since = None
                    for record in _collect_records(client, list(waiting.values())):
                        del waiting[record.name]
                        yield record
            except (OSError, CancelledError) as error:
                lost_since = time.monotonic() if lost_since is None else lost_since
                lost = time.monotonic() - lost_since
                if lost > cluster.patience:
                    raise CatalogError(
                        f"the scheduler {address} could not be reached for {lost:.0f} s ({error}); "
                        f"{len(waiting)} recordings are left: start it, and build again"
                    ) from error
                time.sleep(1.0)


def run_task(task: Task) -> Record:
    """Build a recording on a worker of Dask, which tells the client of its progress."""
    worker = get_worker()
    sent: dict[str, float] = {}

    def report(stage: str, done: float, total: float | None) -> None:
        now = time.monotonic()
        if done == total or now - sent.get(stage, -MIN_INTERVAL_S) >= MIN_INTERVAL_S:
            sent[stage] = now
            worker.log_event(TOPIC, {"progress": (task.recording.name, stage, done, total)})

    report("read", 0, 1)
    return build_recording(task, Path(worker.local_directory), report)


@contextmanager
def _start_workers(cluster: Cluster) -> Iterator[Any]:
    """Yield what a client connects to: the address that was given, or a cluster of this machine."""
    if cluster.scheduler is not None:
        yield cluster.scheduler
        return
    _check_main_guard()
    try:
        if cluster.memory_limit != "auto":
            dask.utils.parse_bytes(cluster.memory_limit)
    except ValueError:
        raise CatalogError(
            f"the memory limit {cluster.memory_limit!r} is no size; give one such as 4GB"
        ) from None
    with LocalCluster(
        n_workers=cluster.workers or dask.system.CPU_COUNT,
        threads_per_worker=1,
        memory_limit=cluster.memory_limit,
        dashboard_address=":0",
        silence_logs=logging.CRITICAL,  # losses of workers are in the records
    ) as local:
        yield local


def _check_main_guard() -> None:
    """Refuse a script that calls without a guard: each worker imports it, and would call again."""
    path = getattr(sys.modules["__main__"], "__file__", None)
    frame = inspect.currentframe()
    while frame is not None and frame.f_back is not None:
        frame = frame.f_back
    if (
        frame is None
        or path is None
        or frame.f_code.co_filename != path
        or frame.f_code.co_name != "<module>"
    ):
        return
    for part in ast.parse(Path(path).read_bytes()).body:
        is_called = part.lineno <= frame.f_lineno <= (part.end_lineno or part.lineno)
        if is_called and not (isinstance(part, ast.If) and "__name__" in ast.dump(part.test)):
            raise CatalogError(
                f"{path}, line {frame.f_lineno}, is run by each worker too, since workers are "
                'processes: put it below `if __name__ == "__main__":`'
            )


@contextmanager
def _connect(address: Any, progress: RecordingProgress) -> Iterator[Client]:
    # losses are handled here; Dask would print their tracebacks
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with Client(address, timeout=CONNECT_S, set_as_default=False) as client:
        client.subscribe_topic(TOPIC, lambda event: progress(*event[1]["progress"]))
        workers = client.scheduler_info(n_workers=-1)["workers"].values()
        if not workers:
            warn(f"the scheduler has no workers yet: dask worker {address} --nthreads 1")
        threads = max((worker["nthreads"] for worker in workers), default=1)
        if threads > 1:
            warn(
                f"workers have up to {threads} threads, and a worker builds one map at a time: "
                "start them with --nthreads 1, as many as there are cores"
            )
        yield client


def _collect_records(client: Client, tasks: Sequence[Task]) -> Iterator[Record]:
    """Yield records until all are there, or the scheduler is lost (CancelledError)."""
    futures: dict[Any, Task] = {
        client.submit(
            run_task,
            task,
            key=f"geoaim-{task.recording.name}-{dask.base.tokenize(task)}",
            priority=-rank,
        ): task
        for rank, task in enumerate(tasks)
    }
    for future in as_completed(list(futures), loop=client.loop):
        if future.cancelled():
            raise CancelledError
        task = futures[future]
        error = future.exception()
        if error is None:
            yield future.result()
        elif isinstance(error, KilledWorker):
            reason = "lost its worker again and again: it may need more memory than the limit"
            yield make_record(task.recording, "failed", reason, task.inputs)
        elif isinstance(error, CommClosedError | CancelledError):
            raise error
        else:
            reason = f"{type(error).__name__}: {error}"
            yield make_record(task.recording, "failed", reason, task.inputs)
        future.release()
