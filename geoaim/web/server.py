"""A server of one view for this machine's browser alone, which stops when its page is closed."""

import json
import secrets
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from geoaim.base.errors import GeoaimError
from geoaim.web.html_file import make_page, read_module
from geoaim.web.map_view import MapView

HOST = "127.0.0.1"
MAX_CALL_BYTES = 1_000_000
# the server stops after this time without any page; a page that is reloaded comes back
CLOSED_S = 2.0
ALIVE_PERIOD_S = 0.5
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; "
        "img-src 'self' blob: data:; connect-src 'self'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class ViewServer(ThreadingHTTPServer):
    """Serves a view at an address with a token; `with` starts it in a thread and closes it."""

    daemon_threads = True

    def __init__(self, view: MapView, port: int = 0) -> None:
        """Bind to this machine's own address; port 0 chooses a free one."""
        super().__init__((HOST, port), _Handler)
        self.view = view
        self.token = secrets.token_urlsafe(16)
        self.open_pages = self.answers_in_work = 0
        self.last_seen = float("inf")  # no page was open yet
        self.lock = threading.Lock()

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server_port}/{self.token}/"

    def serve(self) -> None:
        """Serve until the last page has been closed, or Ctrl-C."""
        threading.Thread(target=self.serve_forever, daemon=True).start()
        try:
            while self.open_pages or time.monotonic() - self.last_seen < CLOSED_S:
                time.sleep(ALIVE_PERIOD_S / 2)
        except KeyboardInterrupt:
            pass
        finally:
            self.shutdown()
            self.server_close()

    def server_close(self) -> None:
        """Close, after the answers in work: torch aborts the process if it ends within them."""
        super().server_close()
        while self.answers_in_work:
            time.sleep(ALIVE_PERIOD_S / 10)

    def handle_error(self, *_: Any) -> None:
        """Write nothing: the browser may leave before an answer is sent."""

    def count_page(self, change: int) -> None:
        """Count a page that was opened (1) or closed (-1)."""
        with self.lock:
            self.open_pages += change
            self.last_seen = time.monotonic()


class _Handler(BaseHTTPRequestHandler):
    """Answers requests of the page, and of no other."""

    protocol_version = "HTTP/1.1"
    server: ViewServer

    def do_GET(self) -> None:
        path = self._find_path()
        if path == "":
            self._send(make_page(str(self.server.view.description["title"])).encode(), "text/html")
        elif path == "geoaim.js":
            self._send(read_module().encode(), "text/javascript")
        elif path == "alive":
            self._stay_alive()
        elif path is not None:
            self._answer(lambda: self.server.view.read(path), "application/octet-stream")

    def do_POST(self) -> None:
        path, call = self._find_path(), self.server.view.call
        length = self.headers.get("Content-Length", "")
        if path is None:
            return
        if path != "call" or call is None:
            self._refuse(HTTPStatus.NOT_FOUND, "nothing can be called here")
        elif self.headers.get("Content-Type") != "application/json":
            self._refuse(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "JSON is needed")
        elif not length.isdecimal() or int(length) > MAX_CALL_BYTES:
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "the request is too long")
        else:
            body = self.rfile.read(int(length))
            self._answer(lambda: json.dumps(call(json.loads(body))).encode(), "application/json")

    def _find_path(self) -> str | None:
        """Find the path after the token; None, with an answer sent, if the request is refused."""
        own = f"{HOST}:{self.server.server_port}"
        origin = self.headers.get("Origin", f"http://{own}")
        _, token, *rest = (*urlsplit(self.path).path.split("/", 2), "")
        if self.headers.get("Host") != own or origin != f"http://{own}":
            self._refuse(HTTPStatus.FORBIDDEN, "this server answers its own page alone")
        elif not secrets.compare_digest(token.encode(), self.server.token.encode()):
            self._refuse(HTTPStatus.FORBIDDEN, "the address lacks the token that was printed")
        else:
            return rest[0]
        return None

    def _answer(self, make: Callable[[], bytes], content_type: str) -> None:
        with self.server.lock:
            self.server.answers_in_work += 1
        try:
            content = make()
        except KeyError as error:
            self._refuse(HTTPStatus.NOT_FOUND, str(error.args[0]))
        except (GeoaimError, ValueError) as error:
            self._refuse(HTTPStatus.UNPROCESSABLE_ENTITY, str(error))
        else:
            self._send(content, content_type)
        finally:
            with self.server.lock:
                self.server.answers_in_work -= 1

    def _send(self, content: bytes, content_type: str, status: int = HTTPStatus.OK) -> None:
        self.send_response(status)
        charset = "; charset=utf-8" if content_type.startswith("text/") else ""
        self.send_header("Content-Type", content_type + charset)
        self.send_header("Content-Length", str(len(content)))
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def _refuse(self, status: HTTPStatus, reason: str) -> None:
        self.close_connection = True  # a body may be left unread
        self._send(reason.encode(), "text/plain", status)

    def _stay_alive(self) -> None:
        """Send comments until the page is gone."""
        self.close_connection = True
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/event-stream")
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.end_headers()
        self.server.count_page(1)
        try:
            while True:
                self.wfile.write(b":\n\n")
                self.wfile.flush()
                time.sleep(ALIVE_PERIOD_S)
        except OSError:
            self.server.count_page(-1)

    def log_message(self, *_: Any) -> None:
        """Write no log."""
