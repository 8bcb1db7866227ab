"""Build a catalogue while workers and the scheduler are killed: what is lost or built twice."""

import socket
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from benchmarks.results import Row
from geoaim.catalog import Cluster, build_catalog, read_catalog, verify_catalog

WORKERS = 2
KILL_WORKERS_AT = (0.2, 0.4)  # shares of the recordings that are done
KILL_SCHEDULER_AT = 0.6
POLL_S = 0.1
PATIENCE_S = 120.0


def measure_losses(table: Path, output: Path, reference: Path) -> list[Row]:
    """Kill two workers and the scheduler, which is started again, while a catalogue is built.

    Args:
        table: of the recordings.
        output: folder of the catalogue.
        reference: folder of the same catalogue, built without losses.

    Returns:
        A row with what was lost, built twice, or differs from the reference.
    """
    expected = read_catalog(reference).records
    with _start_machines() as machines:
        watch = RecordWatch(output)
        killer = _Killer(watch, len(expected), machines)
        thread = threading.Thread(target=killer.run)
        start = time.perf_counter()
        thread.start()
        cluster = Cluster(machines.address, patience=PATIENCE_S)
        records = build_catalog(table, output, cluster=cluster).records
        seconds = time.perf_counter() - start
        killer.stopping.set()
        thread.join()
    assert verify_catalog(output) == []
    pairs = [(record, expected[name]) for name, record in records.items() if name in expected]
    return [
        {
            "workers killed": killer.workers,
            "scheduler killed and started again": killer.schedulers,
            "recordings": len(expected),
            "lost": len(expected.keys() - records.keys()),
            "other status": sum(found.status != wanted.status for found, wanted in pairs),
            "built twice": watch.count_twice(),
            "maps that differ": sum(found.files != wanted.files for found, wanted in pairs),
            "s": round(seconds, 1),
        }
    ]


@dataclass
class _Machines:
    """A scheduler and workers as processes; those that end are started again."""

    port: int
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    @property
    def address(self) -> str:
        return f"tcp://127.0.0.1:{self.port}"

    def keep_alive(self) -> None:
        port, address = str(self.port), self.address
        commands = {"scheduler": ["dask_scheduler", "--port", port, "--no-dashboard"]}
        worker = ["dask_worker", address, "--nthreads", "1", "--no-dashboard"]
        commands |= {f"worker {number}": worker for number in range(WORKERS)}
        for name, (module, *options) in commands.items():
            process = self.processes.get(name)
            if process is None or process.poll() is not None:
                self.processes[name] = subprocess.Popen(
                    [sys.executable, "-m", f"distributed.cli.{module}", *options],
                    stderr=subprocess.DEVNULL,
                )

    def kill_worker(self, number: int) -> bool:
        """Kill the process that builds, whose parent starts another one."""
        parent = psutil.Process(self.processes[f"worker {number}"].pid)
        builders = [c for c in parent.children() if "spawn_main" in " ".join(c.cmdline())]
        for builder in builders:
            builder.kill()
        return bool(builders)


class RecordWatch:
    """Watches the records of a catalogue: one that is written twice was built twice."""

    def __init__(self, catalog: Path) -> None:
        self.catalog = catalog
        self.versions: dict[str, set[tuple[int, int]]] = defaultdict(set)

    def look(self) -> int:
        """Look at all records; return how many recordings have one."""
        for record in self.catalog.glob("recordings/*/record.json"):
            state = record.stat()
            self.versions[record.parent.name].add((state.st_mtime_ns, state.st_ino))
        return len(self.versions)

    def count_twice(self) -> int:
        """Count the recordings whose record was written more than once."""
        return sum(len(versions) > 1 for versions in self.versions.values())


@dataclass
class _Killer:
    """Kills workers and the scheduler as a catalogue grows."""

    watch: RecordWatch
    total: int  # of recordings
    machines: _Machines
    workers: int = 0  # killed
    schedulers: int = 0  # killed
    stopping: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        while not self.stopping.wait(POLL_S):
            share = self.watch.look() / self.total
            if self.workers < WORKERS and share >= KILL_WORKERS_AT[self.workers]:
                self.workers += self.machines.kill_worker(self.workers)
            if share >= KILL_SCHEDULER_AT and not self.schedulers:
                self.machines.processes["scheduler"].kill()
                self.machines.processes["scheduler"].wait()
                self.schedulers += 1
            self.machines.keep_alive()


@contextmanager
def _start_machines() -> Iterator[_Machines]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        machines = _Machines(free.getsockname()[1])
    machines.keep_alive()
    try:
        yield machines
    finally:
        for process in machines.processes.values():
            process.terminate()
        for process in machines.processes.values():
            process.wait(30)
