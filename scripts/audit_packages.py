"""Checks the packages of constraints.txt against known vulnerabilities, as OSV (https://osv.dev) describes them.

    python scripts/audit_packages.py --advisories all.zip|FOLDER|ADVISORY.json [--constraints FILE]
    python scripts/audit_packages.py --osv [--constraints FILE]

The network is used with --osv alone, which sends the names and versions to api.osv.dev. Everything else is offline:
https://osv-vulnerabilities.storage.googleapis.com/PyPI/all.zip holds all advisories about packages of PyPI, some tens
of megabytes.

Prints a line for each vulnerability of a pinned version. Exit code 0 if there is none, 1 if there are some, 2 if the
check could not be made.
"""

from __future__ import annotations

import argparse
import json
import sys
import urllib.error
import urllib.request
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from offline_bundle import ROOT, pinned_versions
from packaging.utils import canonicalize_name
from packaging.version import InvalidVersion, Version

OSV = "https://api.osv.dev/v1/querybatch"
TIMEOUT = 30.0


class NotChecked(Exception):
    """The check could not be made; why, in one line."""


@dataclass(frozen=True, order=True)
class Finding:
    """A vulnerability of a pinned package; `summary` is empty if only its identifier is known."""

    package: str
    version: str
    identifier: str
    summary: str = ""

    def line(self) -> str:
        """All of it in one line."""
        summary = f": {' '.join(self.summary.split())}" if self.summary else ""
        return f"{self.package} {self.version}: {self.identifier}{summary} (https://osv.dev/{self.identifier})"


def findings_offline(pinned: Mapping[str, str], advisories: Path) -> list[Finding]:
    """The vulnerabilities of pinned packages, by advisories in files.

    Args:
        pinned: versions by canonical name.
        advisories: a file in OSV's format (.json), a folder of such files, or an archive (.zip) of them.

    Raises:
        NotChecked: there are none, or one is damaged.
    """
    found, count = set[Finding](), 0
    for name, content in _contents(advisories):
        count += 1
        try:
            advisory = json.loads(content)
            affected = {package for package, version in pinned.items() if is_affected(advisory, package, version)}
            known = (advisory["id"], str(advisory.get("summary", "")))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            raise NotChecked(f"{name}: not an advisory in OSV's format, or damaged") from None
        found |= {Finding(package, pinned[package], *known) for package in affected}
    if not count:
        raise NotChecked(f"{advisories}: no advisories (*.json) in it")
    return sorted(found)


def is_affected(advisory: Mapping[str, Any], package: str, version: str) -> bool:
    """Whether an advisory in OSV's format is about a version of a package of PyPI.

    Source: https://ossf.github.io/osv-schema, "evaluation algorithm".
    """
    if "withdrawn" in advisory:
        return False
    return any(
        entry["package"]["ecosystem"] == "PyPI"
        and canonicalize_name(entry["package"]["name"]) == package
        and (version in entry.get("versions", ()) or _in_ranges(Version(version), entry.get("ranges", ())))
        for entry in advisory.get("affected", ())
    )


def findings_online(pinned: Mapping[str, str]) -> list[Finding]:
    """The same by OSV's own service.

    Raises:
        NotChecked: it cannot be reached, or answers with something else.
    """
    queries = [{"package": {"name": name, "ecosystem": "PyPI"}, "version": version} for name, version in pinned.items()]
    request = urllib.request.Request(
        OSV, json.dumps({"queries": queries}).encode(), {"Content-Type": "application/json"}
    )
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT) as response:
            results = json.load(response)["results"]
        return sorted(
            Finding(name, version, vulnerability["id"])
            for (name, version), result in zip(pinned.items(), results, strict=True)
            for vulnerability in result.get("vulns", ())
        )
    except OSError as error:
        raise NotChecked(
            f"{OSV}: no answer ({getattr(error, 'reason', None) or error}); --advisories FILE checks without a network"
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise NotChecked(f"{OSV}: an answer that cannot be read; --advisories FILE checks without a network") from None


def _contents(advisories: Path) -> Iterator[tuple[str, bytes]]:
    """The advisories in a file, a folder or an archive, with their names."""
    try:
        if advisories.is_dir():
            for path in sorted(advisories.rglob("*.json")):
                yield str(path), path.read_bytes()
        elif advisories.suffix == ".zip":
            with zipfile.ZipFile(advisories) as archive:
                for name in archive.namelist():
                    if name.endswith(".json"):
                        yield f"{advisories}: {name}", archive.read(name)
        else:
            yield str(advisories), advisories.read_bytes()
    except (OSError, zipfile.BadZipFile) as error:
        raise NotChecked(f"{advisories}: cannot be read ({getattr(error, 'strerror', None) or error})") from None


def _in_ranges(version: Version, ranges: list[dict[str, Any]]) -> bool:
    return any(_in_range(version, range["events"]) for range in ranges if range["type"] == "ECOSYSTEM")


def _in_range(version: Version, events: list[dict[str, str]]) -> bool:
    """Whether a version lies between an event that introduces a vulnerability and the one that ends it."""
    affected = False
    for event in sorted(events, key=lambda event: _place(next(iter(event.values())))):
        (kind, text), *_ = event.items()
        place = _place(text)
        if kind == "introduced" and version >= place:
            affected = True
        elif (kind == "fixed" and version >= place) or (kind == "last_affected" and version > place):
            affected = False
    return affected


def _place(text: str) -> Version:
    try:
        # "0" stands for the very first version, before all others.
        return Version("0.dev0") if text == "0" else Version(text)
    except InvalidVersion:
        raise ValueError(f"{text} is no version") from None


def main() -> int:
    """Check, and print what is found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--advisories", type=Path, help="a downloaded file of OSV, or a folder of such")
    source.add_argument("--osv", action="store_true", help="ask api.osv.dev; sends names and versions there")
    parser.add_argument("--constraints", type=Path, default=ROOT / "constraints.txt", help="default: %(default)s")
    arguments = parser.parse_args()
    try:
        try:
            pinned = pinned_versions(arguments.constraints.read_text("utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise NotChecked(f"{arguments.constraints}: cannot be read ({error})") from None
        if not pinned:
            raise NotChecked(f"{arguments.constraints}: pins no package")
        found = findings_online(pinned) if arguments.osv else findings_offline(pinned, arguments.advisories)
    except NotChecked as error:
        print(f"audit_packages: {error}", file=sys.stderr)
        return 2
    for finding in found:
        print(finding.line())
    print(
        f"{len(pinned)} packages of {arguments.constraints.name}, {len(found)} known vulnerabilities", file=sys.stderr
    )
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
