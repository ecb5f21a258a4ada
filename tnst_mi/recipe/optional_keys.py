"""The kinds of recipe values that may be left unset, where files or their formats say more than a default could."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from tnst_mi.recipe.keys import Kind


@dataclass(frozen=True)
class Unset:
    """A value of another kind, or None for "not set"."""

    kind: Kind

    @property
    def expected(self) -> str:
        """The allowed values in words."""
        return self.kind.expected

    @property
    def placeholder(self) -> str:
        """The placeholder for the value in --help."""
        return self.kind.placeholder

    def check(self, value: Any) -> Any:
        """Accept None and what the other kind accepts."""
        return None if value is None else self.kind.check(value)

    def read(self, text: str) -> Any:
        """Read a value of the other kind."""
        return self.kind.read(text)

    def show(self, value: Any) -> str:
        """Write a value as the other kind does."""
        return "not set" if value is None else self.kind.show(value)


@dataclass(frozen=True)
class Point:
    """A place in space: three numbers."""

    placeholder: str = "X,Y,Z"
    expected: str = "three numbers X,Y,Z, such as 0,-2.5,1"

    def check(self, value: Any) -> tuple[float, float, float]:
        """Accept three finite numbers."""
        if not isinstance(value, list | tuple) or len(value) != 3:
            raise ValueError
        for number in value:
            if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
                raise ValueError
        x, y, z = map(float, value)
        return x, y, z

    def read(self, text: str) -> tuple[float, ...]:
        """Read `X,Y,Z`."""
        return tuple(float(part) for part in text.split(","))

    def show(self, value: tuple[float, float, float]) -> str:
        """Write `X,Y,Z`."""
        return ",".join(f"{number:g}" for number in value)
