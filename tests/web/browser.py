"""Helpers that drive the viewer in a browser."""

import threading
from contextlib import contextmanager

from geoaim.web.server import ViewServer
from tests.waiting import wait_until


@contextmanager
def serve(view):
    with ViewServer(view) as server:
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        yield server.address
        server.shutdown()


def wait_for(page, condition):
    """Wait for a JavaScript condition; the page's policy forbids Playwright's own way."""
    wait_until(lambda: page.evaluate(condition), condition)


def open_view(page, address):
    page.goto(address)
    wait_for(page, "Boolean(window.geoaim)")
    wait_for(page, "performance.getEntriesByName('geoaim-painted').length > 0")
