"""A module that is imported once something of it is used: torch takes a second, and rendering does without it."""

from __future__ import annotations

import importlib
from typing import Any


class LazyModule:
    """Stands for a module of that name."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        """Something of the module, which is imported now if it has not been."""
        return getattr(importlib.import_module(self._name), attribute)
