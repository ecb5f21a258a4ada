"""Downloading a file with a known hash: resumable, with a progress bar, moved into place only when complete."""

from __future__ import annotations

import hashlib
import http.client
import os
import urllib.error
import urllib.request
from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.machine.progress_bar import progress_bar

TIMEOUT = 10.0
"""Seconds without an answer after which the network counts as unreachable."""

_CHUNK = 1 << 18
_LARGEST_DOWNLOAD = 1 << 28
"""In bytes, far above every published file. A server cannot fill the disk."""


class Unreachable(Exception):
    """The server did not answer or refused the request; nothing is known about the file."""


def file_hash(path: Path, algorithm: str) -> str:
    """Hexadecimal digest of a file; `algorithm` is a name known to hashlib."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, algorithm).hexdigest()


def download(url: str, target: Path, sha256: str) -> None:
    """Fetch `url` to `target`; `sha256` is the hexadecimal hash of the whole file.

    Partial data are kept in `<target>.part`, from which a later call resumes; an atomic rename creates `target` once
    they are complete and verified. Raises `Unreachable` without a connection, `InputError` if the connection breaks
    off, the hash differs or the folder cannot be written.
    """
    part = target.with_name(target.name + ".part")
    try:
        _fetch(url, part)
        found = file_hash(part, "sha256")
        if found != sha256:
            part.unlink()
            raise InputError(f"{url}: wrong hash: sha256 {found}, expected {sha256}; download deleted, try again")
        os.replace(part, target)
    except OSError as error:
        raise InputError(f"{target}: cannot be written ({error.strerror or error})") from None


def _fetch(url: str, part: Path) -> None:
    """Append the missing rest of the file at `url` to `part`."""
    done = part.stat().st_size if part.exists() else 0
    request = urllib.request.Request(url, headers={"Range": f"bytes={done}-"} if done else {})
    try:
        response = urllib.request.urlopen(request, timeout=TIMEOUT)
    except urllib.error.HTTPError as error:
        if error.code == http.client.REQUESTED_RANGE_NOT_SATISFIABLE:
            return  # nothing is left to fetch; the hash decides
        raise Unreachable(f"{url}: {error.code} {error.reason}") from None
    except (OSError, http.client.HTTPException) as error:
        raise Unreachable(f"{url}: {getattr(error, 'reason', None) or error}") from None
    with response:
        part.parent.mkdir(parents=True, exist_ok=True)
        if response.status != http.client.PARTIAL_CONTENT:
            done = 0  # the server sends the whole file
        announced = response.headers.get("Content-Length", "")
        total = done + int(announced) if announced.isdecimal() else None
        with (
            part.open("ab" if done else "wb") as file,
            progress_bar(total=total, initial=done, unit="B", unit_scale=True, desc=part.stem) as bar,
        ):
            while chunk := _read(response, url, bar.n):
                if bar.n + len(chunk) > _LARGEST_DOWNLOAD:
                    raise InputError(f"{url}: larger than {_LARGEST_DOWNLOAD} bytes; expected GoogLeNet weights")
                file.write(chunk)
                bar.update(len(chunk))
            if total is not None and bar.n < total:
                raise InputError(f"{url}: the connection broke off at {bar.n} of {total} bytes; run again to go on")


def _read(response: http.client.HTTPResponse, url: str, done: int) -> bytes:
    try:
        return response.read1(_CHUNK)
    except (OSError, http.client.HTTPException) as error:
        raise InputError(f"{url}: the connection broke off at {done} bytes ({error}); run again to go on") from None
