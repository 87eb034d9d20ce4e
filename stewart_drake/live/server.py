"""HTTP server of the live page: for this computer only, and for no other web page."""

from __future__ import annotations

import json
import queue
import socket
import sys
import threading
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files

from stewart_drake.base.atomic_files import plain_json
from stewart_drake.base.errors import StewartDrakeError
from stewart_drake.live.session import PageSession

PORTS = range(8000, 8100)
TIMEOUT = 10.0  # [s] of a connection that neither sends nor reads.
MAX_PAGES = 4  # A browser opens six connections to a server; commands need some of them.
MAX_COMMAND = 10_000  # [byte]
SEND_BUFFER = 65_536  # [byte] for a page that reads slowly.
_TYPES = {"html": "text/html; charset=utf-8", "js": "text/javascript; charset=utf-8", "css": "text/css"}
_FILES = {page.name: page for page in (files("stewart_drake") / "pages").iterdir()}


class LiveServer:
    """Serves the page at `url`, its events and its commands, in background threads.

    `about` describes the robot for the page; it is sent once.
    """

    def __init__(self, session: PageSession, about: Mapping[str, object], port: int | None = None) -> None:
        handler = type("Handler", (_Handler,), {"session": session, "about": about})
        self._server = _bind(handler, PORTS if port is None else range(port, port + 1))
        self.url = f"http://localhost:{self._server.server_port}/"
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()

    def close(self) -> None:
        """Stops the server."""
        self._server.open = False
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads, open, request_queue_size = True, True, 64

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        super().__init__(address, handler)
        self.pages = threading.Semaphore(MAX_PAGES)

    def handle_error(self, request: socket.socket | tuple[bytes, socket.socket], client_address: object) -> None:
        """Ignores connections that were closed or timed out."""
        if not isinstance(sys.exception(), (ConnectionError, TimeoutError)):
            super().handle_error(request, client_address)


def _bind(handler: type[BaseHTTPRequestHandler], ports: range) -> _Server:
    for port in ports:
        try:
            return _Server(("127.0.0.1", port), handler)
        except OSError:
            continue
    which = f"port {ports[0]} is not" if len(ports) == 1 else f"no port from {ports[0]} to {ports[-1]} is"
    raise StewartDrakeError(f"{which} free: close another live session")


class _Handler(BaseHTTPRequestHandler):
    session: PageSession
    about: Mapping[str, object]
    server: _Server
    timeout = TIMEOUT

    def parse_request(self) -> bool:
        """Refuses requests to another host name than this computer's, and from pages of another origin."""
        if not super().parse_request():
            return False
        host, site = self.headers.get("Host", ""), self.headers.get("Sec-Fetch-Site", "none")
        allowed = host.rpartition(":")[0] in ("localhost", "127.0.0.1")
        allowed &= self.headers.get("Origin", f"http://{host}") == f"http://{host}"
        # Links from elsewhere may open the page, and nothing else.
        allowed &= site in ("none", "same-origin") or self.path == "/"
        if not allowed:
            self.send_error(HTTPStatus.FORBIDDEN)
        return allowed

    def do_GET(self) -> None:
        """The page, its files, and the rows as server-sent events."""
        name = self.path.lstrip("/") or "live.html"
        if name == "events":
            self._stream()
        elif name == "about":
            self._answer(json.dumps(self.about).encode(), "application/json")
        elif name == "curves":
            self._answer(json.dumps(plain_json(self.session.curves())).encode(), "application/json")
        elif name in _FILES:
            self._answer(_FILES[name].read_bytes(), _TYPES.get(name.rpartition(".")[2], "text/plain"))
        else:
            self.send_error(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        """Takes a command; answers with its number."""
        length = self.headers.get("Content-Length", "")
        if self.path != "/do":
            self.send_error(HTTPStatus.NOT_FOUND)
        # A page of another origin cannot send this type without asking first.
        elif self.headers.get("Content-Type") != "application/json":
            self.send_error(HTTPStatus.UNSUPPORTED_MEDIA_TYPE)
        elif not length.isdecimal():
            self.send_error(HTTPStatus.LENGTH_REQUIRED)
        elif len(length) > len(str(MAX_COMMAND)) or int(length) > MAX_COMMAND:
            self.send_error(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        else:
            try:
                number = self.session.put(json.loads(self.rfile.read(int(length))))
            except (ValueError, RecursionError):
                self.send_error(HTTPStatus.BAD_REQUEST)
            except queue.Full:
                self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)
            else:
                self._answer(json.dumps({"number": number}).encode(), "application/json")

    def log_message(self, *_: object) -> None:
        """Logs nothing."""

    def end_headers(self) -> None:
        """Adds headers against framing by other pages and loading from elsewhere."""
        self.send_header("Content-Security-Policy", "default-src 'self'; img-src data:; frame-ancestors 'none'")
        self.send_header("Cache-Control", "no-store")
        super().end_headers()

    def _answer(self, content: bytes, kind: str) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def _stream(self) -> None:
        if not self.server.pages.acquire(blocking=False):
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)
            return
        try:
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/event-stream")
            self.end_headers()
            count = 0
            while self.server.open:
                # While the loop is busy, a comment checks that the page is still connected.
                count, rows = self.session.rows_after(count, 1.0)
                self.wfile.write("".join(f"data: {row}\n\n" for row in rows).encode() or b": busy\n\n")
        finally:
            self.server.pages.release()
