"""Helpers that drive the viewer in a browser."""

from contextlib import contextmanager

from geoaim.web.server import ViewServer
from tests.waiting import wait_until

SERVERS: set[str] = set()  # addresses that are served now


@contextmanager
def serve(view):
    with ViewServer(view) as server:
        SERVERS.add(server.address)
        yield server.address
        SERVERS.remove(server.address)


def wait_for(page, condition):
    """Wait for a JavaScript condition; the page's policy forbids Playwright's own way."""
    wait_until(lambda: page.evaluate(condition), condition)


def open_view(page, address):
    page.goto(address)
    wait_for(page, "Boolean(window.geoaim)")
    wait_for(page, "performance.getEntriesByName('geoaim-painted').length > 0")
