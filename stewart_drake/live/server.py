"""The page of a live session: served to this machine alone."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any

from stewart_drake.errors import StewartDrakeError
from stewart_drake.live.session import LiveSession

PORTS = range(8000, 8100)
_TYPES = {"html": "text/html; charset=utf-8", "js": "text/javascript", "css": "text/css"}


class LiveServer:
    """Serves the page at `url`, its events and its commands from threads of its own.

    `about` is what the page has to know before the first row.
    """

    def __init__(self, session: LiveSession, about: Mapping[str, Any]) -> None:
        handler = type("Handler", (_Handler,), {"session": session, "about": about})
        self._server = _first_free(handler)
        self.url = f"http://localhost:{self._server.server_port}/"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        """Ends it."""
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Nothing where the page was closed while it asked."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


def _first_free(handler: type[BaseHTTPRequestHandler]) -> _Server:
    for port in PORTS:
        try:
            return _Server(("127.0.0.1", port), handler)
        except OSError:
            continue
    raise StewartDrakeError(f"no port from {PORTS[0]} to {PORTS[-1]} is free: close another live session")


class _Handler(BaseHTTPRequestHandler):
    session: LiveSession
    about: Mapping[str, Any]

    def parse_request(self) -> bool:
        """Refuses who came by another name than this machine's own, as a page of a foreign site would."""
        if not super().parse_request():
            return False
        if self.headers.get("Host", "").rpartition(":")[0] not in ("localhost", "127.0.0.1"):
            self.send_error(HTTPStatus.FORBIDDEN)
            return False
        return True

    def do_GET(self) -> None:
        """The page and its files, what it shows, and the rows as server-sent events."""
        name = self.path.lstrip("/") or "live.html"
        if name == "events":
            self._stream()
        elif name == "about":
            self._answer(json.dumps(self.about).encode(), "application/json")
        else:
            page = files("stewart_drake") / "pages" / name
            if "/" in name or not page.is_file():
                self.send_error(HTTPStatus.NOT_FOUND)
                return
            self._answer(page.read_bytes(), _TYPES.get(name.rpartition(".")[2], "text/plain"))

    def do_POST(self) -> None:
        """A command."""
        # A page of another origin cannot send this type without asking first.
        if self.headers.get("Content-Type") != "application/json":
            self.send_error(HTTPStatus.UNSUPPORTED_MEDIA_TYPE)
            return
        try:
            command = json.loads(self.rfile.read(int(self.headers.get("Content-Length", 0))))
        except ValueError:
            self.send_error(HTTPStatus.BAD_REQUEST)
            return
        self.session.tell(command)
        self._answer(b"{}", "application/json")

    def log_message(self, *_: Any) -> None:
        """Nothing."""

    def _answer(self, content: bytes, kind: str) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def _stream(self) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        rows = self.session.listen()
        try:
            while True:
                self.wfile.write(f"data: {json.dumps(rows.get())}\n\n".encode())
                self.wfile.flush()
        finally:
            self.session.leave(rows)
