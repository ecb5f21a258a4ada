"""Finding GoogLeNet weights: the published files, the search path, and the download.

Search order: the requested file or folder; $TNST_MI_WEIGHTS; the user's cache; a folder `shared/weights` beside the
checkout; the network that ships with the package. The first two are binding: if they hold no usable weights, that is an
error and the search stops, so that a result never comes from a network other than the intended one. Only a flavour
requested by name is downloaded.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import platformdirs

from tnst_mi.errors import InputError
from tnst_mi.network import shipped
from tnst_mi.network.download import Unreachable, download, file_hash
from tnst_mi.network.readers import flavour_of
from tnst_mi.network.readers.network_weights import FLAVOUR_NAMES
from tnst_mi.network.shipped import DOWNLOAD_COMMAND, PATTERNS, shipped_weights
from tnst_mi.resources import SHARED_WEIGHTS, expanded

ENVIRONMENT_VARIABLE = "TNST_MI_WEIGHTS"


@dataclass(frozen=True)
class PublishedFile:
    """A weights file identified by its name, with the hexadecimal SHA-256 of its content."""

    flavour: str
    name: str
    sha256: str
    url: str | None = None


PUBLISHED = (
    PublishedFile(
        "bvlc",
        "googlenet_bvlc.safetensors",
        "8d4a38bb3ec8bb01a9a6c13bf9ee55877a8f5b23ad09f297eb9f03d96b05ea3b",
    ),
    PublishedFile(
        "bvlc",
        "bvlc_googlenet.caffemodel",
        "6f7101e3a2183738a7125a0c5021ba82a1feb4228c5ca0924d991b6daf6f6fad",
        # Published only over http; the hash authenticates the file.
        "http://dl.caffe.berkeleyvision.org/bvlc_googlenet.caffemodel",
    ),
    PublishedFile(
        "inception5h",
        "tensorflow_inception_graph.pb",
        "a39b08b826c9d5a5532ff424c03a3a11a202967544e389aca4b06c2bd8aef63f",
    ),
    PublishedFile(
        "inception5h",
        "inception5h.zip",
        "d13569f6a98159de37e92e9c8ec4dae8f674fbf475f69fe6199b514f756d4364",
        "https://storage.googleapis.com/download.tensorflow.org/models/inception5h.zip",
    ),
    PublishedFile(
        "torchvision",
        "googlenet-1378be20.pth",
        "1378be20a8e875cf1568b8a71654e704449655e34711a959a38b04fb34905cef",
        "https://download.pytorch.org/models/googlenet-1378be20.pth",
    ),
)
"""Preferred files first.

Caffe's own page gives a SHA-1 hash, which no longer proves that a file is the one meant, and torchvision the first 32
bits. The whole SHA-256 hashes are those that TensorFlow's build (inception5h.zip) and Intel's Open Model Zoo (the
caffemodel) check, and that independent projects have found of the graph in inception5h.zip and of torchvision's file.
"""


@dataclass(frozen=True)
class FoundWeights:
    """A weights file on this machine; `hash_ok` is None for an unpublished file."""

    flavour: str
    path: Path
    hash_ok: bool | None


class ChosenWeights(NamedTuple):
    """The weights file to use; `fallback` if this network was not requested but no other was found."""

    path: Path
    flavour: str
    fallback: bool = False


def cache_folder() -> Path:
    """The folder that downloads go to."""
    return platformdirs.user_cache_path("tnst_mi", appauthor=False) / "weights"


def shared_folder() -> Path:
    """`shared/weights` beside the checkout (it need not exist)."""
    return SHARED_WEIGHTS


def find_weights(source: str | Path | None = None, flavour: str | None = None) -> ChosenWeights:
    """The weights file to use and its flavour.

    `source`, like $TNST_MI_WEIGHTS, is a file, a folder of files under their published names, or the str "patterns" for
    the network that ships with the package. `flavour` is one of `FLAVOUR_NAMES`. Without it, the first of them that is
    found is used; with it, a published network that is not found is downloaded. Raises `InputError` if `source` or
    $TNST_MI_WEIGHTS has no weights of that flavour, if a file under a published name has the wrong hash, or if a
    flavour is neither found nor downloadable.
    """
    if flavour is not None and flavour not in FLAVOUR_NAMES:
        raise InputError(f"flavour {flavour!r}: unknown; expected one of {', '.join(FLAVOUR_NAMES)}")
    if source is not None:
        return _at(source, flavour, "weights")
    if flavour == PATTERNS:
        return ChosenWeights(shipped_weights(), PATTERNS)
    if named := os.environ.get(ENVIRONMENT_VARIABLE):
        return _at(named, flavour, f"${ENVIRONMENT_VARIABLE}")
    for wanted in FLAVOUR_NAMES if flavour is None else (flavour,):
        for folder in (cache_folder(), shared_folder()):
            for published in _published(wanted, folder):
                return ChosenWeights(_verified(folder / published.name, published), wanted)
    if flavour is None:
        return ChosenWeights(shipped_weights(), PATTERNS, fallback=True)
    return ChosenWeights(download_weights(flavour), flavour)


@functools.cache
def announce_fallback() -> None:
    """Report on stderr, once per process, that the shipped network replaces one trained on ImageNet."""
    print(
        f"no ImageNet weights found: using the shipped network {PATTERNS}; "
        f"`{DOWNLOAD_COMMAND}` gets the paper's network",
        file=sys.stderr,
    )


def list_weights() -> list[FoundWeights]:
    """Every weights file on the search path of `find_weights`, with its hash checked; for reports.

    Raises `InputError` if $TNST_MI_WEIGHTS names a missing path, or a file that holds no GoogLeNet.
    """
    found, folders = [], [cache_folder(), shared_folder()]
    named = os.environ.get(ENVIRONMENT_VARIABLE)
    if named and named != PATTERNS:
        path = expanded(Path(named))
        if path.is_dir():
            folders.insert(0, path)
        else:
            _require_exists(path, f"${ENVIRONMENT_VARIABLE}")
            found.append(_described(path))
    for folder in folders:
        for flavour in FLAVOUR_NAMES:
            found.extend(_described(folder / published.name) for published in _published(flavour, folder))
    if shipped.FILE.is_file():
        found.insert(0 if named == PATTERNS else len(found), FoundWeights(PATTERNS, shipped.FILE, None))
    return found


def download_weights(flavour: str) -> Path:
    """Download the published weights of a flavour to the cache, unless already there; returns the file.

    Raises `InputError` if the flavour is not published, or cannot be downloaded or written.
    """
    known = next((known for known in PUBLISHED if known.flavour == flavour and known.url), None)
    if known is None or known.url is None:
        downloadable = dict.fromkeys(known.flavour for known in PUBLISHED if known.url)
        raise InputError(f"download {flavour!r}: no such network; expected one of {', '.join(downloadable)}")
    target = cache_folder() / known.name
    if target.is_file() and _described(target).hash_ok:
        return target
    try:
        download(known.url, target, known.sha256)
    except Unreachable as error:
        raise InputError(f"{flavour} weights: no download ({error}); {_instructions(flavour)}") from None
    return target


def _published(flavour: str, folder: Path) -> Iterator[PublishedFile]:
    """The published files of a flavour that exist in the folder, preferred ones first."""
    return (known for known in PUBLISHED if known.flavour == flavour and (folder / known.name).is_file())


def _described(path: Path) -> FoundWeights:
    known = next((known for known in PUBLISHED if known.name == path.name), None)
    if known is None:
        return FoundWeights(flavour_of(path), path, None)
    return FoundWeights(known.flavour, path, file_hash(path, "sha256") == known.sha256)


def _at(source: str | Path, flavour: str | None, origin: str) -> ChosenWeights:
    """The weights at a given path: that file, or the preferred published file in that folder."""
    # Only the bare word: a Path or `./patterns` is a file or folder of that name.
    if source == PATTERNS:
        if flavour not in (None, PATTERNS):
            raise InputError(f"{origin} {PATTERNS}: the shipped network, expected {flavour}; {_instructions(flavour)}")
        return ChosenWeights(shipped_weights(), PATTERNS)
    path = expanded(Path(source))
    _require_exists(path, origin)
    if path.is_dir():
        for wanted in FLAVOUR_NAMES if flavour is None else (flavour,):
            for published in _published(wanted, path):
                return ChosenWeights(_verified(path / published.name, published), wanted)
        raise InputError(
            f"{origin} {path}: no {flavour or 'GoogLeNet'} weights in this folder; {_instructions(flavour)}"
        )
    known = next((known for known in PUBLISHED if known.name == path.name), None)
    if known is not None:
        _verified(path, known)
    found = known.flavour if known else flavour_of(path)
    if flavour not in (None, found):
        raise InputError(f"{origin} {path}: flavour {found}, expected {flavour}; {_instructions(flavour)}")
    return ChosenWeights(path, found)


def _require_exists(path: Path, origin: str) -> None:
    if not path.exists():
        raise InputError(f"{origin} {path}: no such file or folder; expected GoogLeNet weights, or {PATTERNS}")


def _verified(path: Path, known: PublishedFile) -> Path:
    """The path, after checking that the file is the published one."""
    try:
        found = file_hash(path, "sha256")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    if found != known.sha256:
        raise InputError(
            f"{path}: wrong hash: sha256 {found}, expected {known.sha256} (damaged, or another "
            f"network); delete it and run `tnst-mi weights --download {known.flavour}`, or rename it to use it as it is"
        )
    return path


def _instructions(flavour: str | None) -> str:
    """Which files are suitable, their URLs and hashes, and where to put them."""
    if flavour == PATTERNS:
        return f"name it with --weights {PATTERNS}"
    files = [
        f"{known.name} (sha256 {known.sha256}{f', {known.url}' if known.url else ''})"
        for known in PUBLISHED
        if flavour in (None, known.flavour)
    ]
    return (
        f"put one of {', '.join(files)} into {cache_folder()}, "
        f"or name a file or folder with --weights or ${ENVIRONMENT_VARIABLE}"
    )
