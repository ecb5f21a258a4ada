"""The studio's server: HTTP for one page, its pictures and its events, with bounds on all that is sent to it.

It is the server of Python's standard library: the page needs nothing that a framework would add, and works without the
internet. Each connection has a thread, of which there are only so many; what computes takes turns.
"""

from __future__ import annotations

import io
import socket
import socketserver
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import one_line, printable
from tnst_mi.studio.page.access import Access, from_own_page
from tnst_mi.studio.page.connections import Connections, TimedReader
from tnst_mi.studio.page.messages import PageAnswer, PageRequest

#: Answers a request that has been let in.
Routes = Callable[[PageRequest], PageAnswer]

#: Largest body of a request in bytes: of a picture, and of all others.
LARGEST_UPLOAD, LARGEST_BODY = 16 << 20, 64 << 10

#: Where pictures are sent to: to be kept, to be compared with, and painted on the page.
UPLOAD, ALIKE, PAINTING = "/upload", "/alike", "/painting"

#: Seconds after which a connection that sends nothing is closed, in which a request and its headers have to be there
#: once it has begun, and in which the last requests are answered.
_IDLE, _HEAD, _PATIENCE = 60, 5, 10

#: The page loads nothing from elsewhere, is in no frame of another page, and tells nobody where it is.
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob: data:; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}

#: What is answered to other methods than these.
_METHODS = "GET, POST"

_CLOSED = "403: open the URL with the token that tnst-mi studio has printed\n"


class StudioServer(ThreadingHTTPServer):
    """Listens, and lets in whoever has the token.

    Args:
        host: name or address of this machine to listen on.
        port: 0 for any that is free.
        routes: what answers.

    Attributes:
        access: the token.
        connections: those that are open.

    Raises:
        InputError: it cannot listen there.
    """

    daemon_threads = True
    # Connections that wait to be taken: of the system's few, those of strangers would be all.
    request_queue_size = 128

    def __init__(self, host: str, port: int, routes: Routes) -> None:
        self.connections = Connections()
        self._requests, self._fewer, self._closing = 0, threading.Condition(), False
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self.routes = routes
        try:
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(
                one_line(f"studio: cannot listen on {host}, port {port} ({reason}); give another --port or --host")
            ) from None
        self.access = Access()

    def server_bind(self) -> None:
        """Listen, without looking up the name of this machine, which takes seconds where there is no network."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])

    def server_close(self) -> None:
        """Listen no longer, and wait for what is being computed: threads that still do abort a program that ends."""
        super().server_close()
        with self._fewer:
            self._closing = True
            self._fewer.wait_for(lambda: self._requests == 0, _PATIENCE)

    @contextmanager
    def computing(self) -> Iterator[None]:
        """Within the block, something is computed for a request.

        Raises:
            ConnectionAbortedError: the server is closed.
        """
        with self._fewer:
            if self._closing:
                raise ConnectionAbortedError
            self._requests += 1
        try:
            yield
        finally:
            with self._fewer:
                self._requests -= 1
                self._fewer.notify_all()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Give a connection a thread; it counts as one that has not been let in."""
        self.connections.begin(request)
        try:
            super().process_request(request, client_address)
        except RuntimeError:  # the system gives no more threads
            self.connections.end(request)
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection until it ends."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self.connections.end(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Nothing, if the browser has left in the middle; other errors in one line."""
        error = sys.exception()
        if not isinstance(error, OSError):
            print(one_line(f"tnst-mi: studio: {type(error).__name__}: {error}"), file=sys.stderr)


def _largest(path: str) -> int:
    """The largest body of a request."""
    return LARGEST_UPLOAD if path in (UPLOAD, ALIKE, PAINTING) else LARGEST_BODY


class _Handler(BaseHTTPRequestHandler):
    """Answers the requests of a connection."""

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "tnst-mi", ""
    # An answer is sent at once, in one piece: the system would hold the second piece back until the first is confirmed,
    # for 40 ms.
    wbufsize, disable_nagle_algorithm = -1, True
    server: StudioServer  # pyright: ignore[reportIncompatibleVariableOverride]
    # What cannot be read as a request is answered as others are, with headers.
    default_request_version = "HTTP/1.0"

    def setup(self) -> None:
        """Read with a limit on the time of the whole of a request, rather than on that of each part."""
        super().setup()
        self._reader = TimedReader(self.connection)
        self.rfile.close()
        self.rfile = io.BufferedReader(self._reader)

    def handle_one_request(self) -> None:
        """Wait for a request, for as long as whoever sends it may, and answer it."""
        known = self.server.connections.let_in(self.connection)
        self._reader.limit(_IDLE if known else _HEAD)
        try:
            begun = self.rfile.peek(1)  # pyright: ignore[reportAttributeAccessIssue]
        except TimeoutError:
            begun = b""
        if not begun:
            self.close_connection = True
            return
        if known:
            self._reader.limit(_HEAD)
        super().handle_one_request()

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer what is no request, or one that nobody makes, in one line."""
        if code == 501:
            self._refuse(405, f"405: expected one of {_METHODS}\n", {"Allow": _METHODS})
        else:
            self._refuse(code, f"{code}: {one_line(message or HTTPStatus(code).phrase)}\n")

    def do_GET(self) -> None:
        """Answer what asks for something."""
        self._answer("GET")

    def do_POST(self) -> None:
        """Answer what changes something."""
        self._answer("POST")

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: requests come with every move of the mouse."""

    def _answer(self, method: str) -> None:
        try:
            address = urlsplit(self.path)
        except ValueError:
            self._refuse(400, "400: the address is none\n")
            return
        query = dict(parse_qsl(address.query, keep_blank_values=True))
        access = self.server.access
        if method == "GET" and address.path == "/" and access.opened_by(query.get("token", "")):
            # The token leaves the address bar at once.
            if self._is_let_in():
                self._send(PageAnswer(status=303, headers={"Location": "/", "Set-Cookie": access.set_cookie}))
        elif not access.admits(self.headers.get("Cookie")):
            self._refuse(403, _CLOSED)
        elif not self._is_let_in():
            pass
        elif method == "POST" and not from_own_page(self.headers.get("Origin"), self.headers.get("Host")):
            self._refuse(403, "403: only the studio's own page may change something\n")
        elif (body := self._body(_largest(address.path))) is not None:
            self._send(self._routed(PageRequest(method, address.path, query, body)))

    def _is_let_in(self) -> bool:
        """Whether there is room for the connection, which has the token; if not, it has been refused."""
        if self.server.connections.admit(self.connection):
            return True
        self._refuse(503, "503: too many connections; close some tabs\n")
        return False

    def _body(self, largest: int) -> bytes | None:
        """The body of a request; None if it has been refused."""
        text = self.headers.get("Content-Length")
        if self.headers.get("Transfer-Encoding") is not None or (text is None and self.command == "POST"):
            self._refuse(411, "411: the length of the body has to be told\n")
            return None
        # More digits than any size has are none that Python need read.
        if text is not None and not (text.isascii() and text.isdigit() and len(text) < 20):
            self._refuse(400, "400: the length of the body is no number\n")
            return None
        length = int(text or 0)
        if length > largest:
            self._refuse(413, f"413: {length} bytes sent, expected at most {largest}\n")
            return None
        self._reader.limit(_IDLE, each=True)
        body = self.rfile.read(length)
        if len(body) < length:
            self.close_connection = True
            return None
        return body

    def _routed(self, request: PageRequest) -> PageAnswer:
        """What the routes answer; what goes wrong there is one line on the page."""
        try:
            with self.server.computing():
                return self.server.routes(request)
        except ConnectionAbortedError:
            raise
        except InputError as error:
            return PageAnswer.of_json({"error": one_line(str(error))}, 400)
        except Exception as error:
            line = one_line(f"{type(error).__name__}: {error}")
            print(f"tnst-mi: studio: {printable(request.path)}: {line}", file=sys.stderr)
            return PageAnswer.of_json({"error": line}, 500)

    def _refuse(self, status: int, text: str, headers: Mapping[str, str] = {}) -> None:
        # What else is sent is not read.
        self.close_connection = True
        sent = {"Connection": "close", **headers}
        self._send(PageAnswer(text.encode("utf-8"), "text/plain; charset=utf-8", status, sent))

    def _send(self, answer: PageAnswer) -> None:
        if answer.events is not None and not self.server.connections.keep(self.connection):
            self._refuse(503, "503: too many tabs; close some\n")
            return
        self.connection.settimeout(_IDLE)
        self.send_response(answer.status)
        for name, value in (_HEADERS | dict(answer.headers)).items():
            self.send_header(name, value)
        self.send_header("Content-Type", answer.kind)
        if answer.events is None:
            self.send_header("Content-Length", str(len(answer.body)))
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(answer.body)
            return
        # The end of the connection is that of the events.
        self.close_connection = True
        self.end_headers()
        for event in answer.events:
            self.wfile.write(f"data: {event}\n\n".encode() if event else b": still here\n\n")
            self.wfile.flush()
