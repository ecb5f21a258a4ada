"""The download of weights, from a server on this machine."""

from __future__ import annotations

import hashlib
import http.server
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tnst_mi.errors import InputError
from tnst_mi.network import weights

CONTENT = np.random.default_rng(0).bytes(300_000)


class Server(http.server.BaseHTTPRequestHandler):
    """Serves CONTENT; class attributes make it misbehave."""

    ranges = True
    stop_at: int | None = None
    requests: list[str | None]

    def do_GET(self) -> None:
        asked = self.headers["Range"]
        self.requests.append(asked)
        start = int(asked.removeprefix("bytes=").removesuffix("-")) if asked and self.ranges else 0
        if self.path != "/file":
            return self.send_error(404)
        if start >= len(CONTENT):
            return self.send_error(416)
        self.send_response(206 if start else 200)
        self.send_header("Content-Length", str(len(CONTENT) - start))
        self.end_headers()
        self.wfile.write(CONTENT[start : self.stop_at])

    def log_message(self, *_: object) -> None:
        """Quiet."""


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[type[Server]]:
    """A server that the download of bvlc goes to; the cache is `tmp_path / "cache"`."""
    handler = type("Handler", (Server,), {"requests": []})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        threading.Thread(target=running.serve_forever, args=(0.01,), daemon=True).start()
        handler.url = f"http://127.0.0.1:{running.server_port}/file"
        monkeypatch.delenv("TNST_MI_WEIGHTS", raising=False)
        monkeypatch.setattr(weights, "cache_folder", lambda: tmp_path / "cache")
        monkeypatch.setattr(weights, "shared_folder", lambda: tmp_path / "shared")
        publish(monkeypatch, handler.url, hashlib.sha256(CONTENT).hexdigest())
        yield handler
        running.shutdown()


def begin(folder: Path, content: bytes) -> None:
    """What an earlier download left."""
    (folder / "cache").mkdir()
    (folder / "cache" / "net.caffemodel.part").write_bytes(content)


def publish(monkeypatch: pytest.MonkeyPatch, url: str, digest: str) -> None:
    published = weights.PublishedFile("bvlc", "net.caffemodel", digest, url)
    monkeypatch.setattr(weights, "PUBLISHED", (published,))


def test_download(server: type[Server], tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    path = weights.download_weights("bvlc")
    assert path == tmp_path / "cache" / "net.caffemodel"
    assert path.read_bytes() == CONTENT
    assert [file.name for file in path.parent.iterdir()] == ["net.caffemodel"]
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "net.caffemodel: 100%" in captured.err
    assert weights.find_weights() == weights.find_weights(flavour="bvlc") == (path, "bvlc", False)
    assert weights.download_weights("bvlc") == path
    assert len(server.requests) == 1  # the later calls found the file
    path.write_bytes(b"damaged")
    assert weights.download_weights("bvlc").read_bytes() == CONTENT


def test_a_broken_download_goes_on_where_it_stopped(server: type[Server], tmp_path: Path) -> None:
    server.stop_at = 100_000
    with pytest.raises(InputError, match="broke off at 100000 of 300000 bytes; run again"):
        weights.download_weights("bvlc")
    part = tmp_path / "cache" / "net.caffemodel.part"
    assert part.read_bytes() == CONTENT[:100_000]
    server.stop_at = None
    path, *_ = weights.find_weights(flavour="bvlc")
    assert server.requests == [None, "bytes=100000-"]
    assert path.read_bytes() == CONTENT
    assert not part.exists()


def test_a_server_that_cannot_resume_starts_over(server: type[Server], tmp_path: Path) -> None:
    begin(tmp_path, CONTENT[:1000])
    server.ranges = False
    assert weights.download_weights("bvlc").read_bytes() == CONTENT


def test_a_complete_part_is_only_checked(server: type[Server], tmp_path: Path) -> None:
    begin(tmp_path, CONTENT)
    assert weights.download_weights("bvlc").read_bytes() == CONTENT


@pytest.mark.parametrize("begun", [b"", b"stale", CONTENT + b"more"])
def test_a_download_with_a_wrong_hash_leaves_nothing(
    server: type[Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, begun: bytes
) -> None:
    if begun:
        begin(tmp_path, begun)
    else:
        publish(monkeypatch, server.url, "0" * 64)
    with pytest.raises(InputError, match=r"wrong hash: sha256 [0-9a-f]{64}, expected [0-9a-f]{64}"):
        weights.download_weights("bvlc")
    assert list((tmp_path / "cache").iterdir()) == []


def test_hashes_are_whole(server: type[Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The start of a hash could be forged."""
    publish(monkeypatch, server.url, hashlib.sha256(CONTENT).hexdigest()[:16])
    with pytest.raises(InputError, match="wrong hash"):
        weights.download_weights("bvlc")
    (tmp_path / "cache" / "net.caffemodel").write_bytes(CONTENT)
    with pytest.raises(InputError, match="wrong hash"):
        weights.find_weights()


def test_a_server_without_the_file_and_no_server(
    server: type[Server], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    publish(monkeypatch, server.url + "s", "ab" * 20)
    with pytest.raises(InputError, match=r"bvlc weights: no download \(.*404"):
        weights.download_weights("bvlc")
    publish(monkeypatch, "http://127.0.0.1:9/file", "ab" * 20)
    with pytest.raises(InputError, match=r"no download \(http://127\.0\.0\.1:9/file: .*abab"):
        weights.download_weights("bvlc")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_cache_that_cannot_be_written(server: type[Server], tmp_path: Path) -> None:
    (tmp_path / "cache").mkdir(mode=0o500)
    with pytest.raises(InputError, match="cannot be written"):
        weights.download_weights("bvlc")


def test_a_cache_whose_place_is_taken_by_a_file(server: type[Server], tmp_path: Path) -> None:
    (tmp_path / "cache").touch()
    with pytest.raises(InputError, match="cannot be written"):
        weights.download_weights("bvlc")
