"""Houdini's module, which only Houdini has."""

from typing import Any

def __getattr__(name: str) -> Any: ...
