"""Whoever has no token gets nothing, and whoever has one nothing from outside the started folder."""

from __future__ import annotations

import io
import os
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from jobs import frames
from PIL import Image
from studios import Studio, running

from tnst_mi.errors import InputError
from tnst_mi.io import save_frames
from tnst_mi.recipe.recipe import Recipe
from tnst_mi.studio.page.messages import PageAnswer, PageRequest
from tnst_mi.studio.page.server import LARGEST_BODY, LARGEST_UPLOAD, StudioServer
from tnst_mi.studio.places import Places


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    """Three frames in a folder, a secret beside it, and a link to that."""
    folder = tmp_path_factory.mktemp("studio")
    save_frames(folder / "root" / "smoke", frames(0.2, 0.4, 0.3))
    save_frames(folder / "secret", frames(0.5))
    (folder / "root" / "link").symlink_to(folder / "secret")
    with running(folder / "root", folder / "out") as started:
        yield started


PATHS = (
    *("/", "/studio.js", "/work.js", "/events", "/view", "/files", "/motifs", "/thumbnail?style=net", "/nothing"),
    *("/work/picture?id=tries/0001", "/work/recipe?id=tries/0001", "/work/log?id=tries/0001"),
)


@pytest.mark.parametrize("path", PATHS)
def test_nothing_is_answered_without_the_token(studio: Studio, path: str) -> None:
    name, token = studio.cookie.split("=")
    for cookie in (
        "",
        f"{name}=",
        f"{name}={token[:-1]}",
        f"{name}={token}x",
        f"other={token}",
        "\x01;;=",
        f"{name}=é",
    ):
        refused = studio.request("GET", path, Cookie=cookie)
        assert refused.status == 403, cookie
        assert b"token" in refused.body and len(refused.body) < 100


def test_a_wrong_token_sets_no_cookie(studio: Studio) -> None:
    for token in ("", "x", studio.server.access.token + "x", studio.server.access.token[:-1], "%C3%A9"):
        refused = studio.request("GET", f"/?token={token}", Cookie="")
        assert refused.status == 403
        assert refused.headers["Set-Cookie"] is None


def test_the_token_leaves_the_address_and_stays_out_of_scripts(studio: Studio) -> None:
    let_in = studio.request("GET", f"/?token={studio.server.access.token}", Cookie="")
    assert let_in.status == 303 and let_in.headers["Location"] == "/"
    assert {"HttpOnly", "SameSite=Lax"} <= set(let_in.headers["Set-Cookie"].split("; "))
    page = studio.request("GET", "/")
    assert page.status == 200
    assert page.headers["Referrer-Policy"] == "no-referrer"
    assert "default-src 'self'" in page.headers["Content-Security-Policy"]
    assert studio.server.access.token.encode() not in page.body


def test_no_two_studios_have_one_token(studio: Studio) -> None:
    with running(studio.session.places.root, Path("none")) as other:
        assert other.server.access.token != studio.server.access.token
        assert other.request("GET", "/", Cookie=studio.cookie).status == 403
        # Nor one cookie, whatever the port: a browser that goes to both, through tunnels, has both.
        assert other.cookie.split("=")[0] != studio.cookie.split("=")[0]
        assert other.request("GET", "/", Cookie=f"{studio.cookie}; {other.cookie}").status == 200


@pytest.mark.parametrize("path", ["/open", "/set", "/goal", "/upload", "/work", "/cluster"])
def test_pages_of_other_ports_change_nothing(studio: Studio, path: str) -> None:
    """They are of the same site, so that browsers send them our cookie."""
    for origin in ("http://127.0.0.1:1", "http://localhost", "https://evil.example", "null"):
        refused = studio.request("POST", path, b"{}", Origin=origin)
        assert refused.status == 403 and b"own page" in refused.body
    own = f"http://127.0.0.1:{studio.server.server_port}"
    assert studio.request("POST", path, b"{}", Origin=own).status == 400  # let in, but nothing is asked for


ESCAPES = ("..", "../secret", "smoke/../../secret", "/etc", "link", "link/f_07.npz", "smoke/\0", "a" * 5000)


@pytest.mark.parametrize("escape", ESCAPES)
def test_nothing_outside_of_the_started_folder_is_opened_or_listed(studio: Studio, escape: str) -> None:
    for reply in (studio.post("/open", path=escape), studio.get("/files", at=escape)):
        assert reply.status == 400
        assert "is not below" in reply.error
    assert studio.session.shown is None


@pytest.mark.parametrize(
    "path",
    [
        "/..%2f..%2fetc/passwd",
        "/../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/studio.js/..",
        "/data",
    ],
)
def test_urls_are_no_paths(studio: Studio, path: str) -> None:
    assert studio.request("GET", path).status == 404


def test_pictures_of_atlases_are_all_that_thumbnails_show(studio: Studio) -> None:
    for query in ({"atlas": "../secret/f_07.npz"}, {"atlas": "smoke/f_07.npz"}, {"style": "../../x"}, {}):
        assert studio.get("/thumbnail", **query).status == 400


def test_a_folder_is_listed_without_what_links_lead_to(studio: Studio) -> None:
    names = [(entry["name"], entry["kind"]) for entry in studio.get("/files", at="").values]
    assert names == [("smoke", "folder")]
    listed = studio.get("/files", at="smoke").values
    assert [entry["path"] for entry in listed] == ["smoke/f_07.npz", "smoke/f_08.npz", "smoke/f_09.npz"]


def test_runs_and_links_in_circles_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    for name in ("run.json", "recipe.toml"):
        (tmp_path / "run" / name).write_text("{}")
    os.symlink("circle", tmp_path / "circle")
    places = Places(tmp_path)
    assert [(entry["name"], entry["kind"]) for entry in places.entries("")] == [("run", "run")]
    with pytest.raises(InputError, match="is not below"):
        places.within("circle/x")


def test_goals_are_those_that_the_page_offers(studio: Studio) -> None:
    secret = studio.session.places.root.parent / "secret.png"
    secret.write_bytes(png(8, 8))
    for key, goal in (
        ("style", str(secret)),
        ("style", "/none.png"),
        ("style", "../secret.png"),
        ("tag", "no such thing"),
        ("semantic", "nonsense:1"),
        ("semantic", "inception_4b/pool_proj"),
        ("semantic", "inception_4b/pool_proj:-1"),
        ("content", str(secret)),
        ("style", "\0"),
    ):
        refused = studio.post("/goal", key=key, goal=goal)
        assert refused.status == 400 and "\n" not in refused.error
    # What is there and what is not are refused alike.
    there, nowhere = (studio.post("/goal", key="style", goal=str(path)).error for path in (secret, "/none.png"))
    assert there == nowhere
    # What a recipe came with can be removed, but not be chosen again.
    studio.session.settings.base = Recipe(style=(str(secret),), tag=("no such thing",))
    for key, goal in (("style", str(secret)), ("tag", "no such thing")):
        assert [studio.post("/goal", key=key, goal=goal).status for _ in range(2)] == [200, 400]
    studio.session.settings.base = Recipe()


def test_a_long_list_is_sorted_before_it_is_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tnst_mi.studio.places._MOST", 3)
    for name in ("e.npz", "b.npz", "d.npz", "c.npz"):
        (tmp_path / name).touch()
    (tmp_path / "a").mkdir()
    listed = [(entry["name"], entry["kind"]) for entry in Places(tmp_path).entries("")]
    assert listed[:3] == [("a", "folder"), ("b.npz", "frames"), ("c.npz", "frames")]
    assert listed[3:] == [("and 2 more, by their path: tnst-mi studio PATH", "more")]


# ---------------------------------------------------------------- what is sent


def png(width: int, height: int) -> bytes:
    written = io.BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (height, width), np.uint8)).save(written, "PNG")
    return written.getvalue()


def test_an_uploaded_picture_becomes_a_style(studio: Studio) -> None:
    assert studio.request("POST", "/upload?name=../../my%20fire.jpeg", png(8, 6)).status == 200
    motif = studio.get("/motifs", find="fire").values[0]
    assert (motif["key"], motif["title"]) == ("style", "my_fire")
    assert Path(motif["goal"]).parent.name == "pictures"
    thumbnail = studio.request("GET", "/" + motif["thumbnail"])
    assert thumbnail.status == 200 and thumbnail.headers["Content-Type"] == "image/png"
    with Image.open(io.BytesIO(thumbnail.body)) as opened:
        assert opened.size == (96, 96)
    assert studio.session.recipe().style == (motif["goal"],)
    assert studio.post("/goal", key="style", goal=motif["goal"]).status == 200
    assert studio.session.recipe().style == ()


def test_an_uploaded_picture_keeps_its_colours_and_transparency(studio: Studio) -> None:
    pixels, sent = np.random.default_rng(2).integers(1, 256, (8, 6, 4), np.uint8), io.BytesIO()
    Image.fromarray(pixels).save(sent, "PNG")
    assert studio.request("POST", "/upload?name=red.png", sent.getvalue()).status == 200
    with Image.open(studio.session.recipe().style[0]) as kept:
        np.testing.assert_array_equal(np.asarray(kept), pixels)
    (motif,) = [one for one in studio.get("/motifs", find="red").values if one["goal"].endswith("red.png")]
    with Image.open(io.BytesIO(studio.request("GET", "/" + motif["thumbnail"]).body)) as thumbnail:
        assert thumbnail.mode == "RGBA"


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (b"", "picture"),
        (b"GIF89a", "picture"),
        (png(8, 6)[:-30], "picture"),
        (b"<svg xmlns='http://www.w3.org/2000/svg'/>", "picture"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "picture"),
        (png(1, 6), "at least 2 x 2"),
    ],
)
def test_what_is_no_picture_is_refused_in_one_line(studio: Studio, body: bytes, message: str) -> None:
    before = studio.get("/motifs", find="").values
    refused = studio.request("POST", "/upload?name=%1b[31mnone.png", body)
    assert refused.status == 400
    assert message in refused.error and "\n" not in refused.error and "\x1b" not in refused.error
    assert "/tmp" not in refused.error
    assert studio.get("/motifs", find="").values == before


def test_a_small_file_of_a_huge_picture_is_refused(studio: Studio) -> None:
    written = io.BytesIO()
    Image.new("1", (20000, 20000)).save(written, "PNG")
    assert len(written.getvalue()) < 1 << 20
    refused = studio.request("POST", "/upload?name=bomb.png", written.getvalue())
    assert refused.status == 400 and "pixels" in refused.error


@pytest.mark.parametrize(("path", "largest"), [("/upload", LARGEST_UPLOAD), ("/open", LARGEST_BODY)])
def test_bodies_beyond_the_limit_are_refused_before_they_are_read(studio: Studio, path: str, largest: int) -> None:
    head = f"POST {path} HTTP/1.1\r\nHost: x\r\nCookie: {studio.cookie}\r\nContent-Length: {largest + 1}\r\n\r\n"
    assert b" 413 " in raw(studio, head)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ("Content-Length: -1", 400),
        ("Content-Length: 1e3", 400),
        ("Content-Length: " + "9" * 5000, 400),
        ("Transfer-Encoding: chunked", 411),
        ("", 411),
        ("X: " + "x" * 70000, 431),
        ("\r\n".join(f"X{i}: x" for i in range(200)), 431),
    ],
)
def test_malformed_requests_are_refused(studio: Studio, headers: str, status: int) -> None:
    head = f"POST /set HTTP/1.1\r\nHost: x\r\nCookie: {studio.cookie}\r\n{headers}\r\n\r\n"
    assert f" {status} ".encode() in raw(studio, head)


@pytest.mark.parametrize(
    "body", [b"", b"[]", b"{", b"\xff", b"1" * 5000, b"[" * 60000, b'{"key": 1}', b'{"key": "lam"']
)
def test_malformed_values_are_refused(studio: Studio, body: bytes) -> None:
    refused = studio.request("POST", "/set", body)
    assert refused.status == 400 and refused.error


def test_other_methods_are_none(studio: Studio) -> None:
    for method in ("PUT", "DELETE", "OPTIONS", "PATCH", "HEAD"):
        refused = studio.request(method, "/")
        assert refused.status == 405 and refused.headers["Allow"] == "GET, POST"
        assert refused.headers["X-Frame-Options"] == "DENY" and b"<" not in refused.body
        assert (refused.body == b"") == (method == "HEAD")


def test_where_it_cannot_listen_is_said(studio: Studio) -> None:
    for host, port in (("127.0.0.1", studio.server.server_port), ("no.such.host.invalid", 0), ("192.0.2.1", 0)):
        with pytest.raises(InputError, match=f"cannot listen on {host}"):
            StudioServer(host, port, lambda request: pytest.fail("is not asked"))


def test_addresses_of_both_kinds_are_listened_on() -> None:
    for host in ("127.0.0.1", "::1"):
        try:
            socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
        except OSError:
            pytest.skip("this machine has no IPv6")
        server = StudioServer(host, 0, lambda request: pytest.fail("is not asked"))
        assert server.server_port > 0
        server.server_close()


def raw(studio: Studio, text: str) -> bytes:
    """The answer to what is no proper request."""
    with socket.create_connection(("127.0.0.1", studio.server.server_port), timeout=10) as connection:
        connection.sendall(text.encode("latin-1"))
        answer = b""
        while part := connection.recv(4096):
            answer += part
            if b"\r\n\r\n" in answer:
                break
        return answer


def test_the_end_waits_for_what_is_computed(tmp_path: Path) -> None:
    begun, done = threading.Event(), threading.Event()

    def slow(request: PageRequest) -> PageAnswer:
        begun.set()
        time.sleep(0.3)
        done.set()
        return PageAnswer()

    with running(tmp_path, tmp_path / "out") as studio:
        studio.server.routes = slow
        asking = threading.Thread(target=lambda: studio.get("/anything"))
        asking.start()
        assert begun.wait(10)
    # The server is closed at the end of the block; nothing is computed after that.
    assert done.is_set()
    asking.join(10)
    with pytest.raises(ConnectionAbortedError), studio.server.computing():
        pass
