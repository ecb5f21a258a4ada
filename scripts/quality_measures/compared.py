"""What is compared: variants of a recipe, smoke, and the trials that they make together."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from tnst_mi import Frame
from tnst_mi.errors import InputError


@dataclass(frozen=True)
class Variant:
    """One of the ways to stylize: its name, of letters, digits, "-", "." and "_", and its recipe keys."""

    name: str
    keys: Mapping[str, Any]

    def __post_init__(self) -> None:
        """Check the name, which becomes a part of file names."""
        if not re.fullmatch(r"[\w.-]+", self.name):
            raise InputError(f"variant {self.name!r}: expected a name of letters, digits, '-', '.' and '_'")


@dataclass(frozen=True, eq=False)
class Smoke:
    """What is stylized: consecutive frames under a name."""

    name: str
    frames: Sequence[Frame]

    @cached_property
    def digest(self) -> str:
        """Of all densities and velocities."""
        found = hashlib.sha256()
        for frame in self.frames:
            for array in (frame.density, frame.velocity):
                found.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
        return found.hexdigest()


@dataclass(frozen=True, eq=False)
class Trial:
    """One cell of the table."""

    smoke: Smoke
    style: str
    variant: Variant
    iterations: int

    @property
    def name(self) -> str:
        """Of its files."""
        return f"{self.smoke.name}_{Path(self.style).stem}_{self.variant.name}_{self.iterations}"
