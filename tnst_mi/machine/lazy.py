"""A module imported on first use: importing torch takes a second, and rendering does not need it."""

from __future__ import annotations

import importlib
from typing import Any


class LazyModule:
    """Proxy for the module of the given name."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        """An attribute of the module, which is imported first if necessary."""
        return getattr(importlib.import_module(self._name), attribute)
