"""A server of one view for this machine's browser alone, which stops when its page is closed."""

import asyncio
import json
import logging
import mimetypes
import re
import secrets
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from http import HTTPStatus
from pathlib import Path
from types import TracebackType
from typing import Any

from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.netutil import bind_sockets
from tornado.web import Application, RequestHandler

from geoaim.base.errors import GeoaimError
from geoaim.web.map_view import MapView, make_page, read_module

HOST = "127.0.0.1"
MAX_CALL_BYTES = 1_000_000
MAX_HEADER_BYTES = 65_536
REQUEST_S = 10.0  # a client that sends its request more slowly is cut off
ANSWERS_AT_ONCE = 4
CHUNK_BYTES = 1 << 18  # of a video, sent at once
RANGE = re.compile(r"bytes=(\d{1,18})-(\d{1,18})?")
# the server stops after this time without any page; a page that is reloaded comes back
CLOSED_S = 2.0
ALIVE_PERIOD_S = 0.5
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; "
        "img-src 'self' blob: data:; media-src 'self'; connect-src 'self'; frame-ancestors 'none'"
    ),
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class ViewServer:
    """Serves a view at an address with a token; `with` starts it in a thread and closes it."""

    def __init__(self, view: MapView) -> None:
        """Bind to a free port of this machine's own address."""
        self.view = view
        self.token = secrets.token_urlsafe(16)
        self.open_pages = 0
        self.last_seen = float("inf")  # no page was open yet
        self.workers = ThreadPoolExecutor(ANSWERS_AT_ONCE)
        self._sockets = bind_sockets(0, HOST)
        self.server_address: tuple[str, int] = self._sockets[0].getsockname()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server_address[1]}/{self.token}/"

    def __enter__(self) -> "ViewServer":
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self.workers.shutdown()  # torch aborts the process if it ends within an answer

    def wait(self) -> None:
        """Wait until the last page has been closed, or for Ctrl-C."""
        try:
            while self.open_pages or time.monotonic() - self.last_seen < CLOSED_S:
                time.sleep(ALIVE_PERIOD_S / 2)
        except KeyboardInterrupt:
            pass

    def count_page(self, change: int) -> None:
        """Count a page that was opened (1) or closed (-1)."""
        self.open_pages += change
        self.last_seen = time.monotonic()

    def _run(self) -> None:
        """Answer requests until the loop is stopped, then close all connections."""
        asyncio.set_event_loop(self._loop)
        logging.getLogger("tornado").addHandler(logging.NullHandler())
        handlers = [(".*", _Handler, {"server": self})]
        server = HTTPServer(
            Application(handlers, log_function=lambda _: None),
            max_body_size=MAX_CALL_BYTES,
            max_header_size=MAX_HEADER_BYTES,
            idle_connection_timeout=REQUEST_S,
            body_timeout=REQUEST_S,
        )
        self._loop.call_soon(server.add_sockets, self._sockets)
        self._loop.run_forever()
        server.stop()
        answers = asyncio.gather(*asyncio.all_tasks(self._loop), return_exceptions=True)
        self._loop.run_until_complete(server.close_all_connections())
        self._loop.run_until_complete(answers)
        self._loop.close()


class _Handler(RequestHandler):
    """Answers requests of the page, and of no other."""

    def initialize(self, server: ViewServer) -> None:
        self.server = server

    def set_default_headers(self) -> None:
        for name, value in HEADERS.items():
            self.set_header(name, value)
        self.clear_header("Server")

    def prepare(self) -> None:
        """Refuse requests from other pages, and those without the token."""
        own = f"{HOST}:{self.server.server_address[1]}"
        origin = self.request.headers.get("Origin", f"http://{own}")
        _, token, *rest = (*self.request.path.split("/", 2), "", "")
        self.inner_path = rest[0]  # after the token
        if self.request.headers.get("Host") != own or origin != f"http://{own}":
            self._refuse(HTTPStatus.FORBIDDEN, "this server answers its own page alone")
        elif not secrets.compare_digest(token.encode(), self.server.token.encode()):
            self._refuse(HTTPStatus.FORBIDDEN, "the address lacks the token that was printed")

    async def get(self) -> None:
        path, view = self.inner_path, self.server.view
        if path == "":
            self._send(make_page(str(view.description["title"])).encode(), "text/html")
        elif path == "geoaim.js":
            self._send(read_module().encode(), "text/javascript")
        elif path == "alive":
            await self._stay_alive()
        elif path == "video" and view.video is not None:
            await self._send_video(view.video)
        else:
            await self._answer(lambda: view.read(path), "application/octet-stream")

    async def post(self) -> None:
        call = self.server.view.call
        if self.inner_path != "call" or call is None:
            self._refuse(HTTPStatus.NOT_FOUND, "nothing can be called here")
        elif self.request.headers.get("Content-Type") != "application/json":
            self._refuse(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "JSON is needed")
        else:
            body = self.request.body
            await self._answer(
                lambda: json.dumps(call(_read_action(body))).encode(), "application/json"
            )

    async def _answer(self, make: Callable[[], bytes], content_type: str) -> None:
        loop = asyncio.get_running_loop()
        try:
            content = await loop.run_in_executor(self.server.workers, make)
        except KeyError as error:
            self._refuse(HTTPStatus.NOT_FOUND, str(error.args[0]))
        except (GeoaimError, ValueError) as error:
            self._refuse(HTTPStatus.UNPROCESSABLE_ENTITY, str(error))
        else:
            self._send(content, content_type)

    def _send(self, content: bytes, content_type: str) -> None:
        charset = "; charset=utf-8" if content_type.startswith("text/") else ""
        self.set_header("Content-Type", content_type + charset)
        self.finish(content)

    def _refuse(self, status: HTTPStatus, reason: str) -> None:
        self.set_status(status)
        self._send(reason.encode(), "text/plain")

    def write_error(self, status_code: int, **_: Any) -> None:
        """Answer what went wrong without its traceback."""
        self._refuse(HTTPStatus(status_code), HTTPStatus(status_code).phrase)

    async def _send_video(self, path: Path) -> None:
        """Send a video from the byte on that the player asks for, as far as it listens."""
        try:
            file, size = path.open("rb"), path.stat().st_size
        except OSError:
            return self._refuse(HTTPStatus.NOT_FOUND, f"{path.name} is not there any more")
        asked = RANGE.fullmatch(self.request.headers.get("Range", ""))
        first = int(asked[1]) if asked else 0
        last = min(int(asked[2]), size - 1) if asked and asked[2] else size - 1
        with file:
            if first > last:
                self.set_header("Content-Range", f"bytes */{size}")
                return self._refuse(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, "no such bytes")
            self.set_status(HTTPStatus.PARTIAL_CONTENT if asked else HTTPStatus.OK)
            if asked:
                self.set_header("Content-Range", f"bytes {first}-{last}/{size}")
            self.set_header("Accept-Ranges", "bytes")
            self.set_header("Content-Type", mimetypes.guess_type(path)[0] or "video/mp4")
            self.set_header("Content-Length", str(last + 1 - first))
            file.seek(first)
            with suppress(StreamClosedError):  # players ask anew where they seek
                for begin in range(first, last + 1, CHUNK_BYTES):
                    self.write(file.read(min(CHUNK_BYTES, last + 1 - begin)))
                    await self.flush()

    async def _stay_alive(self) -> None:
        """Send comments until the page is gone."""
        self.set_header("Content-Type", "text/event-stream")
        self.server.count_page(1)
        try:
            while True:
                self.write(b":\n\n")
                await self.flush()
                await asyncio.sleep(ALIVE_PERIOD_S)
        except StreamClosedError:
            pass
        finally:
            self.server.count_page(-1)


def _read_action(body: bytes) -> dict[str, Any]:
    try:
        action = json.loads(body)
    except RecursionError:
        raise ValueError("the JSON is nested too deeply") from None
    if not isinstance(action, dict):
        raise ValueError(f"a JSON object is needed, found {str(action)[:40]}")
    return action
