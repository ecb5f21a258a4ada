"""The check of pinned packages against known vulnerabilities: by files, and by a service that is played here."""

from __future__ import annotations

import http.server
import json
import sys
import threading
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import audit_packages
import pytest
from audit_packages import ROOT, is_affected, pinned_versions


def advisory(identifier: str, package: str, ecosystem: str = "PyPI", **affected: Any) -> dict[str, Any]:
    entry = {"package": {"name": package, "ecosystem": ecosystem}, **affected}
    return {"id": identifier, "summary": "Bad\nthings", "affected": [entry]}


def between(*events: tuple[str, str], kind: str = "ECOSYSTEM") -> list[dict[str, Any]]:
    return [{"type": kind, "events": [{name: version} for name, version in events]}]


@pytest.mark.parametrize(
    ("ranges", "versions", "version", "affected"),
    [
        (between(("introduced", "0"), ("fixed", "2.0")), [], "1.9.9", True),
        (between(("introduced", "0"), ("fixed", "2.0")), [], "2.0", False),
        (between(("introduced", "0"), ("fixed", "2.0")), [], "2.0rc1", True),
        (between(("introduced", "1.5"), ("last_affected", "2.0")), [], "2.0", True),
        (between(("introduced", "1.5"), ("last_affected", "2.0")), [], "2.0.1", False),
        (between(("introduced", "1.5"), ("fixed", "2.0")), [], "1.4", False),
        # As numbers, not as text; and events in any order, more than one pair.
        (between(("introduced", "1.9"), ("fixed", "1.11")), [], "1.10", True),
        (between(("fixed", "4"), ("introduced", "3"), ("fixed", "2"), ("introduced", "1")), [], "3.5", True),
        (between(("fixed", "4"), ("introduced", "3"), ("fixed", "2"), ("introduced", "1")), [], "2.5", False),
        (between(("introduced", "0")), [], "99", True),
        ([], ["1.0", "1.1"], "1.1", True),
        ([], ["1.0", "1.1"], "1.2", False),
        # Ranges of commits say nothing of versions.
        (between(("introduced", "0"), kind="GIT"), [], "1.0", False),
    ],
)
def test_which_versions_an_advisory_is_about(
    ranges: list[Any], versions: list[str], version: str, affected: bool
) -> None:
    assert is_affected(advisory("X-1", "Deep_Er", ranges=ranges, versions=versions), "deep-er", version) is affected


def test_advisories_about_something_else() -> None:
    everything = between(("introduced", "0"))
    assert not is_affected(advisory("X-1", "deep", ranges=everything), "deep-er", "1")
    assert not is_affected(advisory("X-1", "deep-er", "npm", ranges=everything), "deep-er", "1")
    withdrawn = advisory("X-1", "deep-er", ranges=everything) | {"withdrawn": "2026-01-01T00:00:00Z"}
    assert not is_affected(withdrawn, "deep-er", "1")


@pytest.fixture
def pins(tmp_path: Path) -> Path:
    (tmp_path / "constraints.txt").write_text("# versions\nDeep_Er==1.0\nother==2.0\n")
    return tmp_path / "constraints.txt"


def audit(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["audit_packages.py", *map(str, arguments)])
    return audit_packages.main()


@pytest.mark.parametrize("form", ["file", "folder", "archive"])
def test_offline(
    form: str, pins: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("urllib.request.urlopen", lambda *_, **__: pytest.fail("uses the network"))
    bad = json.dumps(advisory("PYSEC-1", "deep.er", ranges=between(("introduced", "0"), ("fixed", "1.1"))))
    good = json.dumps(advisory("PYSEC-2", "other", ranges=between(("introduced", "0"), ("fixed", "1.1"))))
    source = tmp_path / "advisories"
    if form == "archive":
        source = tmp_path / "all.zip"
        with zipfile.ZipFile(source, "w") as archive:
            archive.writestr("PYSEC-1.json", bad)
            archive.writestr("PYSEC-2.json", good)
    elif form == "folder":
        source.mkdir()
        (source / "PYSEC-1.json").write_text(bad)
        (source / "PYSEC-2.json").write_text(good)
    else:
        source = tmp_path / "PYSEC-1.json"
        source.write_text(bad)
    assert audit(monkeypatch, "--advisories", source, "--constraints", pins) == 1
    told = capsys.readouterr()
    assert told.out == "deep-er 1.0: PYSEC-1: Bad things (https://osv.dev/PYSEC-1)\n"
    assert told.err == "2 packages of constraints.txt, 1 known vulnerabilities\n"
    pins.write_text("deep-er==1.1\n")
    assert audit(monkeypatch, "--advisories", source, "--constraints", pins) == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "cannot be read"), ("{", "not an advisory"), ("[]", "not an advisory"), ("{}" * 3, "not an advisory")],
)
def test_what_cannot_be_checked_is_said_in_one_line(
    content: str | None,
    message: str,
    pins: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if content is not None:
        (tmp_path / "a.json").write_text(content)
    assert audit(monkeypatch, "--advisories", tmp_path / "a.json", "--constraints", pins) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("audit_packages: ") and message in line


def test_no_source_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        audit(monkeypatch)
    assert "one of the arguments --advisories --osv is required" in capsys.readouterr().err


class Service(http.server.BaseHTTPRequestHandler):
    """OSV, which knows of one vulnerability."""

    answer: ClassVar[dict[str, Any]] = {"results": [{"vulns": [{"id": "PYSEC-1", "modified": "2026"}]}, {}]}
    asked: list[Any]

    def do_POST(self) -> None:
        self.asked.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        content = json.dumps(self.answer).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Quiet."""


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[Service]]:
    handler = type("Handler", (Service,), {"asked": []})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        threading.Thread(target=running.serve_forever, args=(0.01,), daemon=True).start()
        monkeypatch.setattr(audit_packages, "OSV", f"http://127.0.0.1:{running.server_port}/")
        yield handler
        running.shutdown()


def test_online(
    service: type[Service], pins: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert audit(monkeypatch, "--osv", "--constraints", pins) == 1
    assert capsys.readouterr().out == "deep-er 1.0: PYSEC-1 (https://osv.dev/PYSEC-1)\n"
    ask = [
        {"package": {"name": n, "ecosystem": "PyPI"}, "version": v} for n, v in (("deep-er", "1.0"), ("other", "2.0"))
    ]
    assert service.asked == [{"queries": ask}]
    # Fewer answers than questions would leave packages unchecked.
    service.answer = {"results": [{}]}
    assert audit(monkeypatch, "--osv", "--constraints", pins) == 2
    assert "an answer that cannot be read" in capsys.readouterr().err


def test_without_a_network_there_is_one_line(
    pins: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(audit_packages, "OSV", "http://127.0.0.1:9/")
    assert audit(monkeypatch, "--osv", "--constraints", pins) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no answer" in line and line.endswith("--advisories FILE checks without a network")


def test_every_line_of_the_constraints_pins_a_package() -> None:
    text = (ROOT / "constraints.txt").read_text("utf-8")
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    assert len(pinned_versions(text)) == len(lines) > 30
