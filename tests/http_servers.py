"""Web servers on this machine, for tests of what reads from addresses."""

import http.server
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def run_servers(
    handler: type[http.server.BaseHTTPRequestHandler],
) -> Iterator[Callable[..., tuple[http.server.ThreadingHTTPServer, str]]]:
    """Yield a function that starts a server with attributes for its handler; stop all at the end.

    The function returns the server and its address.
    """
    running = []

    def start(**attributes: object) -> tuple[http.server.ThreadingHTTPServer, str]:
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        vars(server).update(attributes, daemon_threads=True)
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        running.append(server)
        return server, f"http://127.0.0.1:{server.server_port}"

    yield start
    for server in running:
        server.shutdown()
        server.server_close()
