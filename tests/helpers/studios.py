"""Studios on a port of this machine, and a client that talks to them as a browser does."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

from tnst_mi.studio.choices.examples import ExampleMaker
from tnst_mi.studio.choices.motifs import MotifBrowser
from tnst_mi.studio.page.routes import StudioRoutes
from tnst_mi.studio.page.server import StudioServer
from tnst_mi.studio.places import Places
from tnst_mi.studio.session import Session


@dataclass
class Reply:
    """What a studio answered."""

    status: int
    headers: http.client.HTTPMessage
    body: bytes

    @property
    def values(self) -> Any:
        return json.loads(self.body)

    @property
    def error(self) -> str:
        return self.values["error"]


@dataclass
class Studio:
    """A running studio, and the cookie with which requests are let in."""

    server: StudioServer
    session: Session
    cookie: str = ""

    def __post_init__(self) -> None:
        let_in = self.request("GET", f"/?token={self.server.access.token}")
        assert let_in.status == 303
        self.cookie = let_in.headers["Set-Cookie"].split(";")[0]

    def request(self, method: str, path: str, body: bytes | None = None, **headers: str) -> Reply:
        """A request with the studio's cookie, unless another one is given."""
        connection = http.client.HTTPConnection("127.0.0.1", self.server.server_port, timeout=60)
        try:
            sent = {"Cookie": self.cookie} | {name.replace("_", "-"): value for name, value in headers.items()}
            connection.request(method, path, body, sent)
            response = connection.getresponse()
            return Reply(response.status, response.headers, response.read())
        finally:
            connection.close()

    def get(self, path: str, /, **query: object) -> Reply:
        return self.request("GET", f"{path}?{urlencode(query)}")

    def post(self, path: str, /, **values: object) -> Reply:
        return self.request("POST", path, json.dumps(values).encode(), Content_Type="application/json")


@contextmanager
def running(root: Path, out: Path) -> Iterator[Studio]:
    """A studio below a folder."""
    session = Session(Places(root), out)
    examples = ExampleMaker(out)
    routes = StudioRoutes(session, MotifBrowser(session.places, out), examples)
    server = StudioServer("127.0.0.1", 0, routes)
    serving = threading.Thread(target=lambda: server.serve_forever(0.02), daemon=True)
    serving.start()
    try:
        yield Studio(server, session)
    finally:
        examples.end()
        session.end()
        server.shutdown()
        server.server_close()
        serving.join(5)
