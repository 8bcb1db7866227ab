import http.client
import json
import re
import socket
import threading
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest

from geoaim.web import server as served
from geoaim.web.map_view import MapView
from geoaim.web.server import ViewServer
from tests.waiting import LIMIT_S, wait_until

SECRET = {"kind": "view", "title": "a <b> & c", "rasters": []}


def refuse(action):
    if action.get("bad"):
        raise ValueError("a point needs u and v")
    return {"got": action}


@pytest.fixture
def server():
    with ViewServer(MapView(SECRET, call=refuse)) as started:
        yield started


def ask(server, path, method="GET", body=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=LIMIT_S)
    connection.putrequest(method, path, skip_host="Host" in headers)
    names = {name.replace("_", "-"): value for name, value in headers.items()}
    if body is not None:
        names.setdefault("Content-Length", str(len(body)))
    for name, value in names.items():
        connection.putheader(name, value)
    connection.endheaders(body)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content, answer.headers


def test_its_own_page_gets_everything(server):
    status, page, headers = ask(server, f"/{server.token}/")
    assert status == 200
    assert b"a &lt;b&gt; &amp; c" in page
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert ask(server, f"/{server.token}/geoaim.js")[0] == 200
    status, content, _ = ask(server, f"/{server.token}/description.json")
    assert json.loads(content) == SECRET


def test_a_player_gets_the_bytes_of_a_video_that_it_asks_for(tmp_path):
    content = bytes(range(256)) * 4000
    (tmp_path / "hover.mp4").write_bytes(content)
    view = MapView(SECRET, video=tmp_path / "hover.mp4")
    with ViewServer(view) as started:
        path = f"/{started.token}/video"
        for asked, expected, place in (
            ("bytes=0-", content, f"bytes 0-{len(content) - 1}"),
            ("bytes=700000-", content[700000:], f"bytes 700000-{len(content) - 1}"),
            ("bytes=5-8", content[5:9], "bytes 5-8"),
        ):
            status, answer, headers = ask(started, path, Range=asked)
            assert (status, answer) == (206, expected)
            assert headers["Content-Range"] == f"{place}/{len(content)}"
            assert headers["Content-Type"] == "video/mp4"
        assert ask(started, path, Range=f"bytes={len(content)}-")[0] == 416
        assert ask(started, path)[:2] == (200, content)
        (tmp_path / "hover.mp4").unlink()
        assert ask(started, path)[0] == 404
    with ViewServer(MapView(SECRET)) as without:
        assert ask(without, f"/{without.token}/video")[0] == 404


def test_it_listens_on_this_machine_alone(server):
    assert server.server_address[0] == "127.0.0.1"


@pytest.mark.parametrize("path", ["/", "/wrong/", "/description.json", "//", "/%00/"])
def test_without_the_token_nothing_is_told(server, path):
    status, content, _ = ask(server, path)
    assert status == 403
    assert b"title" not in content


def test_other_origins_and_hosts_are_refused(server):
    path = f"/{server.token}/description.json"
    own = f"127.0.0.1:{server.server_address[1]}"
    for headers in (
        {"Origin": "https://evil.example"},
        {"Origin": "null"},
        {"Host": "evil.example"},
        {"Host": f"localhost.evil.example:{server.server_address[1]}"},
    ):
        assert ask(server, path, **headers)[0] == 403
    assert ask(server, path, Host=own, Origin=f"http://{own}")[0] == 200


@pytest.mark.parametrize("path", ["../../etc/passwd", "%2e%2e/%2e%2e/etc/passwd", "/etc/passwd"])
def test_no_path_leads_outside(server, path):
    assert ask(server, f"/{server.token}/{path}")[0] == 404


def test_calls_are_answered_or_refused_by_one_line(server):
    path, kind = f"/{server.token}/call", {"Content_Type": "application/json"}
    status, content, _ = ask(server, path, "POST", b'{"u": 1}', **kind)
    assert (status, json.loads(content)) == (200, {"got": {"u": 1}})
    status, content, _ = ask(server, path, "POST", b'{"bad": 1}', **kind)
    assert (status, content) == (422, b"a point needs u and v")
    assert ask(server, path, "POST", b"{", **kind)[0] == 422
    assert ask(server, path, "POST", b"{}", Content_Type="text/plain")[0] == 415
    for length in ("9999999999", "9" * 5000, "-1", "x"):
        assert ask(server, path, "POST", None, Content_Length=length, **kind)[0] == 400
    for body in (b"[]", b"1", b"null", b"[" * 100_000):
        assert ask(server, path, "POST", body, **kind)[0] == 422
    assert ask(server, "/wrong/call", "POST", b"{}", **kind)[0] == 403
    server.view = replace(server.view, call=None)
    assert ask(server, path, "POST", b"{}", **kind)[0] == 404


def test_it_stops_when_its_last_page_is_closed(monkeypatch):
    passes, now = [], [0.0]  # of the loop that decides when to stop, and its clock

    def sleep(_):
        if threading.current_thread() is waiting:
            passes.append(now[0])
        time.sleep(0.001)

    def pass_seconds(seconds):
        now[0] += seconds
        wait_until(lambda: not waiting.is_alive() or passes.count(now[0]) > 2, "it looks thrice")

    clock = SimpleNamespace(monotonic=lambda: now[0], sleep=sleep)
    monkeypatch.setattr(served, "time", clock)
    with ViewServer(MapView(SECRET)) as started:
        waiting = threading.Thread(target=started.wait, daemon=True)
        waiting.start()
        pass_seconds(1000.0)
        assert waiting.is_alive()  # the page was not opened yet
        connection = http.client.HTTPConnection("127.0.0.1", started.server_address[1])
        connection.request("GET", f"/{started.token}/alive")
        answer = connection.getresponse()
        assert answer.read(3) == b":\n\n"
        pass_seconds(1000.0)
        assert waiting.is_alive()
        answer.close()
        connection.close()
        wait_until(lambda: started.open_pages == 0, "the server sees that the page is closed")
        pass_seconds(served.CLOSED_S / 2)
        assert waiting.is_alive()  # a page that is reloaded comes back
        pass_seconds(served.CLOSED_S)
        waiting.join(LIMIT_S)
        assert not waiting.is_alive()


def test_half_open_clients_take_no_threads_and_the_page_answers(server):
    clients = [socket.create_connection(server.server_address) for _ in range(200)]
    for client in clients:
        client.sendall(b"GET / HTTP/1.1\r\nHost: ")
    assert ask(server, f"/{server.token}/")[0] == 200
    assert threading.active_count() < 50
    for client in clients:
        client.close()


@pytest.mark.parametrize(
    "request_line", [b"GET http://[::1 HTTP/1.1", b"GET  HTTP/1.1", b"\xff\xfe", b"BREW / HTTP/1.1"]
)
def test_an_odd_request_is_answered(server, request_line):
    with socket.create_connection(server.server_address, timeout=LIMIT_S) as client:
        client.sendall(request_line + b"\r\nHost: a\r\nConnection: close\r\n\r\n")
        assert re.match(rb"HTTP/1.1 4\d\d ", client.recv(100))
