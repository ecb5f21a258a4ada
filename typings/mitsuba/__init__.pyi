"""Mitsuba as an untyped module: its types come into being when a variant is chosen; see the stub of Dr.Jit."""

from typing import Any

def __getattr__(name: str) -> Any: ...
