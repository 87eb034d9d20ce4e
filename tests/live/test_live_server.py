"""The server of a live session against pages of other origins, and against what no page would send."""

import json
import queue
import socket
import threading
import time
from contextlib import ExitStack

import pytest

from stewart_drake.live import server as live_server
from stewart_drake.live.server import MAX_COMMAND, MAX_PAGES, LiveServer
from stewart_drake.live.session import COMMANDS_KEPT, ROWS_KEPT, LiveSession
from stewart_drake.scenario.scenario import load_scenario

JSON = {"Content-Type": "application/json"}


def new_session():
    return LiveSession(load_scenario("exact_fig7").replace({"plant.kind": "closed_form", "reference": "hold"}))


@pytest.fixture(scope="module")
def running():
    """A session at work."""
    session, ended = new_session(), threading.Event()

    def go_on():
        while not ended.is_set():
            session.run(0.1)

    runner = threading.Thread(target=go_on)
    runner.start()
    yield session
    ended.set()
    runner.join()


@pytest.fixture
def patience():
    return 1.0


@pytest.fixture
def server(running, patience, capfd, monkeypatch):
    monkeypatch.setattr(live_server._Handler, "timeout", patience)
    opened = LiveServer(running, {"name": "made up"})
    yield opened
    opened.close()
    # Whatever is sent, nothing is printed.
    assert capfd.readouterr() == ("", "")


def port(server):
    return int(server.url.rpartition(":")[2].strip("/"))


def connect(server):
    return socket.create_connection(("127.0.0.1", port(server)), timeout=5.0)


def status(server, start, headers=(), body=b""):
    """Status of the answer to a request, None where the connection is closed without one."""
    head = {"Host": f"localhost:{port(server)}", **dict(headers)}
    text = f"{start} HTTP/1.1\r\n" + "".join(
        f"{name}: {value}\r\n" for name, value in head.items() if value is not None
    )
    with connect(server) as end:
        try:
            end.sendall(text.encode() + b"\r\n" + body)
            line = end.makefile("rb").readline()
        except ConnectionError:
            return None
    return int(line.split()[1]) if line else None


def test_the_page_and_what_it_needs_are_served_to_itself(server):
    for path in ("/", "/live.js", "/scene.js", "/plots.js", "/three.min.js", "/common.css", "/about", "/events"):
        assert status(server, f"GET {path}", {"Sec-Fetch-Site": "same-origin"}) == 200
    assert status(server, "GET /", {"Sec-Fetch-Site": "cross-site"}) == 200
    own = {"Origin": f"http://localhost:{port(server)}", "Sec-Fetch-Site": "same-origin"}
    body = json.dumps({"do": "move", "on": True}).encode()
    assert status(server, "POST /do", {**JSON, **own, "Content-Length": len(body)}, body) == 200


@pytest.mark.parametrize("start", ["GET /events", "GET /about", "GET /scene.js", "POST /do"])
@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example:8000"},
        {"Host": None},
        {"Host": "localhost.evil.example:8000"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://localhost:1"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ],
)
def test_who_comes_from_elsewhere_is_refused(server, start, headers):
    assert status(server, start, {**JSON, "Content-Length": "2", **headers}, b"{}") == 403


@pytest.mark.parametrize(
    ("length", "body", "answer"),
    [
        ("1000000000000", b"", 413),
        (str(MAX_COMMAND + 1), b"", 413),
        ("9" * 5000, b"", 413),
        ("-1", b"", 411),
        (None, b"", 411),
        ("ten", b"", 411),
        ("5000", b"[" * 5000, 400),
        ("1", b"{", 400),
        # Longer than what comes: the connection is given up.
        ("100", b"{}", None),
    ],
)
def test_a_body_is_bounded_and_must_be_json(server, length, body, answer):
    assert status(server, "POST /do", {**JSON, "Content-Length": length}, body) == answer


@pytest.mark.parametrize(
    ("start", "answer"),
    [
        ("GET /" + "a" * 60_000, 404),
        ("GET /" + "a" * 1_000_000, 414),
        ("GET /../live/server.py", 404),
        ("GET /%00", 404),
        ("GET /pages/live.js", 404),
        ("POST /events", 404),
        ("DELETE /do", 501),
    ],
)
def test_a_path_that_is_none_of_the_page_is_not_found(server, start, answer):
    # The longest one may find the connection closed before it is sent.
    assert status(server, start, {**JSON, "Content-Length": "2"}) in (answer, None if answer == 414 else answer)


def test_a_command_of_another_type_is_refused(server):
    assert status(server, "POST /do", {"Content-Type": "text/plain", "Content-Length": "2"}, b"{}") == 415


def listen(server):
    end = connect(server)
    # What is not read soon fills up what the system keeps for the connection.
    end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    end.sendall(f"GET /events HTTP/1.1\r\nHost: localhost:{port(server)}\r\n\r\n".encode())
    return end


def wait(come):
    deadline = time.monotonic() + 20.0
    while not come():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def wait_for_room(server):
    wait(lambda: status(server, "GET /events") == 200)


@pytest.mark.parametrize("patience", [30.0])
def test_pages_are_counted_the_loop_goes_on_and_who_leaves_makes_room(server, running):
    with ExitStack() as ends:
        for _ in range(200):
            ends.enter_context(listen(server))
        assert status(server, "GET /events") in (503, None)
        # How fast it goes on depends on how busy this machine is.
        later = running.loop.time + 0.5
        wait(lambda: running.loop.time > later)
    wait_for_room(server)


@pytest.mark.parametrize("patience", [0.5])
def test_who_never_reads_is_given_up(server):
    with ExitStack() as ends:
        for _ in range(MAX_PAGES):
            ends.enter_context(listen(server))
        wait_for_room(server)
        assert status(server, "GET /events") == 200


def test_one_who_reads_slowly_misses_rows_and_nobody_keeps_them():
    session = new_session()
    count, _ = session.rows_after(0, 0.0)
    for _ in range(3 * ROWS_KEPT):
        session.publish(session.row())
    later, rows = session.rows_after(count, 0.0)
    assert (later, len(rows)) == (count + 3 * ROWS_KEPT, ROWS_KEPT)
    assert session.rows_after(later, 0.01) == (later, [])
    assert json.loads(rows[-1])["session"] == session.name


def test_commands_that_nobody_obeys_are_refused_in_the_end():
    session = new_session()
    for number in range(COMMANDS_KEPT):
        assert session.put({"do": "pause", "on": False}) == number + 1
    with pytest.raises(queue.Full):
        session.put({"do": "pause", "on": True})
    session.run(0.1)
    assert session.row()["obeyed"] == COMMANDS_KEPT
    assert session.put({"do": "pause", "on": True}) == COMMANDS_KEPT + 1
