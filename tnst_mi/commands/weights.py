"""`tnst-mi weights`: which network weights are at hand and how to get others."""

from __future__ import annotations

from dataclasses import dataclass

from tnst_mi.commands.base import Command


@dataclass(kw_only=True)
class Weights(Command):
    """List the GoogLeNet weights that are found, and say where others come from."""

    def run(self) -> int:
        """Print one line for each file found and for each that is published."""
        from tnst_mi.weights import ENVIRONMENT_VARIABLE, PUBLISHED, cache_folder, list_weights, shared_folder

        found = list_weights()
        for weights in found:
            state = {True: "hash verified", False: "WRONG HASH", None: "not a published file"}[weights.hash_ok]
            print(f"found      {weights.flavour:12} {weights.path} ({state})")
        if not found:
            print("found      none")
        for file in PUBLISHED:
            print(f"published  {file.flavour:12} {file.name} ({file.algorithm} {file.digest})")
            if file.url:
                print(f"{'':24}{file.url}")
        print(f"places     --weights FILE|FOLDER, then ${ENVIRONMENT_VARIABLE}, then")
        print(f"           {cache_folder()} (downloads go there), then")
        print(f"           {shared_folder()}")
        return 0
