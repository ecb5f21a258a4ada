"""Who has no token keeps nobody out, however many connections are open and however slow what they send comes."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from studios import Studio, running

from tnst_mi.studio.page import connections, server


@pytest.fixture
def studio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Studio]:
    monkeypatch.setattr(server, "_HEAD", 0.5)
    (tmp_path / "root").mkdir()
    with running(tmp_path / "root", tmp_path / "out") as started:
        yield started


def connected(studio: Studio, sent: str = "") -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", studio.server.server_port), timeout=10)
    connection.sendall(sent.encode())
    return connection


def asked(connection: socket.socket, studio: Studio, path: str) -> bytes:
    """The first line that is answered."""
    connection.sendall(f"GET {path} HTTP/1.1\r\nHost: x\r\nCookie: {studio.cookie}\r\n\r\n".encode())
    return connection.recv(65536).split(b"\r\n")[0]


@pytest.mark.parametrize("sent", ["", "GET / HTTP/1.1\r\nHost"])
def test_many_connections_of_strangers_keep_nobody_out(studio: Studio, sent: str) -> None:
    strangers = [connected(studio, sent) for _ in range(100)]
    assert studio.request("GET", "/").status == 200
    assert len(studio.server.connections._strangers) <= connections._STRANGERS
    for stranger in strangers:
        stranger.close()


def test_a_byte_now_and_then_does_not_hold_a_connection(studio: Studio) -> None:
    with connected(studio) as stranger:
        begun = time.monotonic()
        try:
            while time.monotonic() < begun + 5:
                stranger.sendall(b"G")
                stranger.settimeout(0.1)
                try:
                    if stranger.recv(1) == b"":
                        break
                except TimeoutError:
                    pass
        except ConnectionError:
            pass
        assert 0.3 < time.monotonic() - begun < 3


def test_a_connection_that_was_let_in_stays_for_other_requests(studio: Studio) -> None:
    with connected(studio) as connection:
        assert b"200" in asked(connection, studio, "/examples")
        time.sleep(0.8)  # longer than a stranger has
        assert b"200" in asked(connection, studio, "/examples")


def test_tabs_that_hear_of_news_leave_room_for_what_they_ask_for(
    studio: Studio, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "_KEPT", 3)
    tabs = [connected(studio) for _ in range(4)]
    assert [asked(tab, studio, "/events").split()[1] for tab in tabs] == [b"200"] * 3 + [b"503"]
    assert studio.request("GET", "/").status == 200
    # The room of one that has left is free, and there is a limit for all that were let in.
    monkeypatch.setattr(connections, "_CONNECTIONS", 3)
    assert studio.request("GET", "/").status == 503
    for tab in tabs:
        tab.close()


@pytest.mark.parametrize(
    ("head", "status"),
    [
        ("GET http://[ HTTP/1.1", 400),
        ("GET //[ HTTP/1.1", 403),
        ("GET", 400),
        ("nonsense\x01 / x y z", 400),
        ("GET / HTTP/9.9", 505),
        ("GET /" + "x" * 70000 + " HTTP/1.1", 414),
        ("TRACE / HTTP/1.1", 405),
        ("HEAD / HTTP/1.1", 405),
    ],
)
def test_what_is_no_request_is_answered_in_one_line(
    studio: Studio, head: str, status: int, capfd: pytest.CaptureFixture[str]
) -> None:
    with connected(studio, f"{head}\r\nHost: x\r\n\r\n") as connection:
        answer = b""
        try:
            while part := connection.recv(65536):
                answer += part
        except ConnectionError:
            pass
    first, _, rest = answer.partition(b"\r\n")
    assert first.split()[1] == str(status).encode()
    assert b"X-Frame-Options: DENY" in rest and b"<" not in rest
    assert capfd.readouterr().err == ""
