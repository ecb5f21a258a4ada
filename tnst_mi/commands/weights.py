"""`tnst-mi weights`: which network weights are available and how to get others."""

from __future__ import annotations

from tnst_mi.commands.arguments import WeightsArguments
from tnst_mi.network import shipped
from tnst_mi.network.readers import read_weights
from tnst_mi.network.shipped import DOWNLOAD_COMMAND, PAPERS_FLAVOUR, PATTERNS
from tnst_mi.network.weights import (
    ENVIRONMENT_VARIABLE,
    PUBLISHED,
    cache_folder,
    download_weights,
    list_weights,
    shared_folder,
)


def run(arguments: WeightsArguments) -> int:
    """Download, list the tags, or print one line for each file found and each file published."""
    if arguments.download is not None:
        _download(arguments.download or (PAPERS_FLAVOUR,))
    elif arguments.tags:
        _list_tags()
    else:
        _list()
    return 0


def _download(flavours: tuple[str, ...]) -> None:
    for flavour in flavours:
        print(f"found      {flavour:12} {download_weights(flavour)} (hash verified)")


def _list_tags() -> None:
    for name in read_weights(shipped.shipped_weights()).class_names or ():
        print(name)


def _list() -> None:
    found = list_weights()
    for weights in found:
        state = {True: "hash verified", False: "WRONG HASH", None: "not a published file"}[weights.hash_ok]
        if weights.path == shipped.FILE:
            state = "shipped; tnst-mi weights --tags lists its class tags"
        print(f"found      {weights.flavour:12} {weights.path} ({state})")
    if not found:
        print("found      none")
    for file in PUBLISHED:
        print(f"published  {file.flavour:12} {file.name} (sha256 {file.sha256})")
        if file.url:
            print(f"{'':24}{file.url}")
    print(f"places     --weights FILE|FOLDER|{PATTERNS}, then ${ENVIRONMENT_VARIABLE}, then")
    print(f"           {cache_folder()} (downloads go there), then")
    print(f"           {shared_folder()}, then")
    print(f"           the network that ships with the package, {PATTERNS}")
    print(f"download   {DOWNLOAD_COMMAND} (or bvlc, torchvision)")
