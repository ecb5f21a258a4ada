"""`tnst-mi weights`: which network weights are at hand and how to get others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import tyro

from tnst_mi.commands.base import Command
from tnst_mi.network import shipped
from tnst_mi.network.shipped import DOWNLOAD_COMMAND, PAPERS_FLAVOUR, PATTERNS


@dataclass(kw_only=True)
class Weights(Command):
    """List the GoogLeNet weights that are found, and say where others come from."""

    download: Annotated[
        tuple[str, ...] | None,
        tyro.conf.arg(
            metavar="[inception5h|bvlc|torchvision]",
            help_behavior_hint=f"(without a name: {PAPERS_FLAVOUR}, the paper's)",
        ),
    ] = None
    """Fetch a published network into the user cache, checked against its hash, for runs to find."""
    tags: bool = False
    """List the class tags of the network that ships with the package, synonyms behind commas."""

    def run(self) -> int:
        """Download, or list the tags, or else print one line for each file found and for each that is published."""
        if self.download is not None:
            self._download(self.download or (PAPERS_FLAVOUR,))
        elif self.tags:
            self._list_tags()
        else:
            self._list()
        return 0

    def _download(self, flavours: tuple[str, ...]) -> None:
        from tnst_mi.network.weights import download_weights

        for flavour in flavours:
            print(f"found      {flavour:12} {download_weights(flavour)} (hash verified)")

    def _list_tags(self) -> None:
        from tnst_mi.network.readers import read_weights

        for name in read_weights(shipped.shipped_weights()).class_names or ():
            print(name)

    def _list(self) -> None:
        from tnst_mi.network.weights import ENVIRONMENT_VARIABLE, PUBLISHED, cache_folder, list_weights, shared_folder

        found = list_weights()
        for weights in found:
            state = {True: "hash verified", False: "WRONG HASH", None: "not a published file"}[weights.hash_ok]
            if weights.path == shipped.FILE:
                state = "shipped; tnst-mi weights --tags lists its class tags"
            print(f"found      {weights.flavour:12} {weights.path} ({state})")
        if not found:
            print("found      none")
        for file in PUBLISHED:
            print(f"published  {file.flavour:12} {file.name} ({file.algorithm} {file.digest})")
            if file.url:
                print(f"{'':24}{file.url}")
        print(f"places     --weights FILE|FOLDER|{PATTERNS}, then ${ENVIRONMENT_VARIABLE}, then")
        print(f"           {cache_folder()} (downloads go there), then")
        print(f"           {shared_folder()}, then")
        print(f"           the network that ships with the package, {PATTERNS}")
        print(f"download   {DOWNLOAD_COMMAND} (or bvlc, torchvision)")
