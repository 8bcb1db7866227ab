"""Helpers that drive the viewer in a browser."""

import threading
import time
from contextlib import contextmanager

from geoaim.web.server import ViewServer


@contextmanager
def serve(view):
    with ViewServer(view) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.address
        server.shutdown()


def wait_for(page, condition, seconds=20):
    """Wait for a JavaScript condition; the page's policy forbids Playwright's own way."""
    end = time.monotonic() + seconds
    while not page.evaluate(condition):
        assert time.monotonic() < end, f"still not: {condition}"
        time.sleep(0.05)


def open_view(page, address):
    page.goto(address)
    wait_for(page, "Boolean(window.geoaim)")
    wait_for(page, "performance.getEntriesByName('geoaim-painted').length > 0")
