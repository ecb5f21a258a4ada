"""The network that ships with the package: its name, its file, and the command that downloads another one."""

from __future__ import annotations

from pathlib import Path

from tnst_mi.errors import InputError
from tnst_mi.resources import DATA

PATTERNS = "patterns"
"""The flavour, and the word for it wherever weights are named; write `./patterns` for a file of that name."""

FILE = DATA / "googlenet_patterns.safetensors"

PAPERS_FLAVOUR = "inception5h"
"""The network that the paper's channel numbers refer to."""

DOWNLOAD_COMMAND = f"tnst-mi weights --download {PAPERS_FLAVOUR}"


def shipped_weights() -> Path:
    """The file of the shipped network; raises `InputError` if the installation lacks it."""
    if not FILE.is_file():
        raise InputError(
            f"{FILE}: the network that ships with the package is missing; install the package again, "
            f"or get another network with `{DOWNLOAD_COMMAND}`"
        )
    return FILE
