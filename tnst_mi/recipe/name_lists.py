"""The kind of recipe values that choose among things by their names: all, none, or a list."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Names:
    """ "all", "none", or names separated by commas; in TOML also a list of names.

    Attributes:
        placeholder: in --help.
        expected: in messages.
    """

    placeholder: str = "all|NAMES|none"
    expected: str = '"all", "none", or names of grids, such as "flame,temperature"'

    def check(self, value: Any) -> str:
        """Accept texts and lists of texts, of which no name is empty."""
        names = value.split(",") if isinstance(value, str) else value
        if not isinstance(names, list | tuple) or not names:
            raise ValueError
        if not all(isinstance(name, str) and name.strip() and "," not in name for name in names):
            raise ValueError
        return ",".join(name.strip() for name in names)

    def read(self, text: str) -> str:
        """The text is the value."""
        return text

    def show(self, value: str) -> str:
        """The value is the text."""
        return value
