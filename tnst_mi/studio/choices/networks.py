"""The network that recipes of a studio are run with, told apart from others by what its file holds."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tnst_mi.errors import InputError
from tnst_mi.machine.terminal import one_line
from tnst_mi.network.download import file_hash
from tnst_mi.network.weights import find_weights

#: Digits of a hash that are told.
_DIGITS = 8


@dataclass(frozen=True)
class UsedNetwork:
    """A network.

    Attributes:
        flavour: such as "bvlc".
        path: of its file.
        sha256: of what that holds.
    """

    flavour: str
    path: Path
    sha256: str

    @classmethod
    def of(cls, weights: str | None) -> UsedNetwork:
        """The one with which a recipe is run.

        Args:
            weights: the recipe's key.

        Raises:
            InputError: they cannot be used.
        """
        found = find_weights(weights)
        written = found.path.stat()
        return cls(found.flavour, found.path, _hash(found.path, written.st_mtime_ns, written.st_size))

    @property
    def name(self) -> str:
        """What tells it from others, such as "bvlc 8d4a38bb"."""
        return network_name(self.flavour, self.sha256)


@functools.lru_cache(16)
def _hash(path: Path, _written: int, _size: int) -> str:
    return file_hash(path, "sha256")


def network_name(flavour: object, sha256: object) -> str:
    """What tells a network from others.

    Example:
        >>> network_name("bvlc", "8d4a38bb3ec8bb01a9a6c13bf9ee5587")
        'bvlc 8d4a38bb'
    """
    return f"{flavour} {str(sha256)[:_DIGITS]}"


def require_network(of: str, recorded: str | None, weights: str | None, remedy: str) -> str:
    """Check that a recipe is run with the network that something has been made by; returns the name of the network.

    Args:
        of: what has been made.
        recorded: the name of the network that has made it; None if that is not known.
        weights: the recipe's key.
        remedy: what else can be done than to start the studio with that network.

    Raises:
        InputError: it is another network, or the weights cannot be used.
    """
    name = UsedNetwork.of(weights).name
    if recorded not in (None, name):
        raise InputError(
            one_line(
                f"studio: {of} is of the network {recorded}, and this would be done by {name}; start the studio with "
                f"the former as its --weights, or {remedy}"
            )
        )
    return name


def network_of_run(record: Mapping[str, Any] | None) -> str | None:
    """The name of the network by which a run was made, as its record says; None without one, or where it does not."""
    made_by = (record or {}).get("weights")
    if not isinstance(made_by, dict) or not isinstance(made_by.get("sha256"), str):
        return None
    return network_name(made_by.get("flavour"), made_by["sha256"])


class NetworksTold:
    """Tells tabs which network a recipe is run with: each is looked for once, since they are told often."""

    def __init__(self) -> None:
        self._told: dict[str | None, dict[str, Any]] = {}

    def of(self, weights: str | None) -> dict[str, Any]:
        """Its flavour and its file, as values for JSON; without a flavour and why, if the weights cannot be used."""
        if weights not in self._told:
            try:
                found = find_weights(weights)
            except InputError as error:
                return {"flavour": None, "file": one_line(str(error))}
            self._told[weights] = {"flavour": found.flavour, "file": one_line(str(found.path))}
        return self._told[weights]
