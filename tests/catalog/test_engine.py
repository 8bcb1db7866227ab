import os
import signal
import threading
from concurrent.futures import CancelledError
from contextlib import nullcontext
from types import SimpleNamespace

import pytest
from distributed import LocalCluster

from geoaim.catalog import Cluster, Recording, build_catalog, engine, verify_catalog
from geoaim.catalog.building import make_record, make_task
from tests.waiting import LIMIT_S


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(table, tmp_path):
    catalog = tmp_path / "maps"
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as cluster:
        started = threading.Event()

        def kill():
            started.wait(LIMIT_S)
            os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

        def progress(name, stage, done, total):
            if stage == "register":
                started.set()

        killer = threading.Thread(target=kill)
        killer.start()
        result = build_catalog(
            table, catalog, cluster=Cluster(cluster.scheduler_address), progress=progress
        )
        killer.join()
    status = {name: record.status for name, record in result.records.items()}
    assert status == {"broken": "refused", "east": "built"}
    assert verify_catalog(catalog) == []


def test_patience_counts_from_the_loss_of_the_scheduler(monkeypatch):
    task = make_task(Recording("east", "east.mp4"), [], "maps")
    record, runs = make_record(task.recording, "built", ""), iter(["lost", "found"])
    now = [0.0]

    def pass_seconds(seconds):
        now[0] += seconds

    def run(client, tasks):
        if next(runs) == "lost":
            pass_seconds(30.0)  # of work, longer than the patience
            raise CancelledError
        yield record

    clock = SimpleNamespace(monotonic=lambda: now[0], sleep=pass_seconds)
    monkeypatch.setattr(engine, "time", clock)
    monkeypatch.setattr(engine, "_connect", lambda *_: nullcontext())
    monkeypatch.setattr(engine, "_collect_records", run)
    cluster = Cluster("tcp://somewhere:8786", patience=20.0)
    assert list(engine.run_tasks([task], cluster, lambda *_: None)) == [record]


def test_an_error_of_a_worker_fails_its_recording_alone(monkeypatch):
    def fail(task):
        raise OSError("no space left on device")

    monkeypatch.setattr(engine, "run_task", fail)
    task = make_task(Recording("east", "east.mp4"), [], "maps")
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as local:
        cluster = Cluster(local.scheduler_address)
        (record,) = engine.run_tasks([task], cluster, lambda *_: None)
    assert (record.status, record.reason) == ("failed", "OSError: no space left on device")
