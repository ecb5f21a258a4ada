"""What a run keeps between its steps: arrays by group, frame and generation, numbers, and a log.

A generation counts how often an item has been replaced.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection
from typing import Any

import numpy as np

#: What one item holds, by name.
Arrays = dict[str, np.ndarray]


class Store(ABC):
    """Items by group and frame. Of each the newest generation is kept, and earlier ones for as long as they are needed.

    Attributes:
        bytes_read, bytes_written: of arrays, so far.
    """

    bytes_read: int = 0
    bytes_written: int = 0

    @abstractmethod
    def generation(self, group: str, frame: int) -> int:
        """The newest generation of an item; −1 if it does not exist."""

    @abstractmethod
    def has(self, group: str, frame: int, generation: int) -> bool:
        """Whether an item is there in this generation."""

    @abstractmethod
    def read(
        self, group: str, frame: int, names: Collection[str] | None = None, generation: int | None = None
    ) -> Arrays:
        """The arrays of an item, or only the named ones, as they were written.

        Args:
            group, frame: of the item.
            names: of the arrays; None for all.
            generation: which one; None for the newest.

        Raises:
            DamagedItemError: the item is not what was written.
        """

    @abstractmethod
    def write(self, group: str, frame: int, generation: int, arrays: Arrays, durable: bool = False) -> None:
        """Write an item, replacing its earlier generations.

        Args:
            group, frame, generation: of the item.
            arrays: by name.
            durable: whether it has to outlast a loss of power, with the log so far.
        """

    @abstractmethod
    def discard(self, group: str, frame: int, generation: int | None = None) -> None:
        """Remove an item, or only one generation of it."""

    @abstractmethod
    def remove(self, group: str) -> None:
        """Remove all items of a group, if there are any, in one step."""

    @abstractmethod
    def clear(self) -> None:
        """Remove all items and numbers, so that the run begins anew; the log stays."""

    @abstractmethod
    def note(self, remark: str) -> None:
        """Say something to the user."""

    @abstractmethod
    def numbers(self, name: str) -> dict[str, float] | None:
        """A set of named numbers, or None if it has not been written.

        Raises:
            DamagedItemError: the numbers are not what was written.
        """

    @abstractmethod
    def write_numbers(self, name: str, numbers: dict[str, float]) -> None:
        """Write a set of named numbers."""

    @abstractmethod
    def log(self, entry: dict[str, Any]) -> None:
        """Add an entry to the log; its "frame" is the name of the frame that it is about."""

    @abstractmethod
    def entries(self, frame: str) -> list[dict[str, Any]]:
        """The log of a frame so far."""
