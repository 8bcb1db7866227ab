"""Build a catalogue in an object store that fails and is slow, by moto's S3 server."""

import logging
import os
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any
from unittest.mock import patch
from urllib.request import Request, urlopen

import fsspec

from benchmarks.results import Row
from geoaim.catalog import Cluster, build_catalog, read_catalog, verify_catalog

BUCKET = "s3://recordings"
EVERY_FAILURE, EVERY_DELAY, DELAY_S = 10, 5, 0.3  # requests that fail, that are slow, by how much


def measure_store(table: Path, reference: Path) -> list[Row]:
    """Build a catalogue in a store, from inputs in the store.

    Args:
        table: of the recordings, in the folder of their files.
        reference: folder of the same catalogue, built on this machine's disk.

    Returns:
        A row for a store without faults, and one for a store with.
    """
    return [_measure(table, reference, faults) for faults in (False, True)]


def _measure(table: Path, reference: Path, faults: bool) -> Row:
    expected = read_catalog(reference).records
    with serve_store(faults=faults) as requests:
        store = fsspec.filesystem("s3")
        for path in table.parent.iterdir():
            store.put_file(str(path), f"recordings/in/{path.name}")
        start = time.perf_counter()
        source, target = f"{BUCKET}/in/{table.name}", f"{BUCKET}/maps"
        records = build_catalog(source, target, cluster=Cluster(workers=2)).records
        seconds = time.perf_counter() - start
        problems = verify_catalog(target)
        again = build_catalog(source, target, cluster=Cluster(workers=2)).built_now
    return {
        "requests that fail, %": 100 / EVERY_FAILURE if faults else 0.0,
        f"requests {DELAY_S} s late, %": 100 / EVERY_DELAY if faults else 0.0,
        "requests": requests["answered"],
        "recordings": len(records),
        "other status": sum(records[name].status != expected[name].status for name in expected),
        "maps that differ": sum(records[name].files != expected[name].files for name in expected),
        "problems by verify": len(problems),
        "built by the second run": len(again),
        "s": round(seconds, 1),
    }


@contextmanager
def serve_store(*, faults: bool) -> Iterator[Mapping[str, int]]:
    """Serve S3 on this machine, with an empty bucket, and set the variables by which it is found.

    Args:
        faults: whether every tenth request fails and every fifth is late.

    Yields:
        The number of requests that were answered, as "answered".
    """
    # by name: a package for tests
    from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import make_server

    application = DomainDispatcherApplication(create_backend_app)
    numbers, requests = count(1), {"answered": 0}

    def answer(environment: Any, start_response: Any) -> Any:
        number = requests["answered"] = next(numbers)
        if faults and number % EVERY_FAILURE == 0:
            start_response("503 Slow Down", [("Content-Type", "application/xml")])
            return [b"<Error><Code>SlowDown</Code><Message>later</Message></Error>"]
        if faults and number % EVERY_DELAY == 1:
            time.sleep(DELAY_S)
        return application(environment, start_response)

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = make_server("127.0.0.1", 0, answer, threaded=True)
    variables = {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{server.server_port}",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    # moto keeps the buckets of earlier servers in this process
    urlopen(Request(f"{variables['AWS_ENDPOINT_URL']}/moto-api/reset", method="POST"))
    with patch.dict(os.environ, variables):
        kind = fsspec.get_filesystem_class("s3")
        kind.clear_instance_cache()
        fsspec.filesystem("s3").mkdir("recordings")
        yield requests
        kind.clear_instance_cache()
    server.shutdown()
    thread.join()
    server.server_close()
