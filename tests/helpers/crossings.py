"""Counts what crosses from the device to the host."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from typing import Any

import drjit as dr
import pytest
import torch

#: Operations that read values of arrays.
_READS: dict[type, tuple[str, ...]] = {
    dr.ArrayBase: ("numpy", "item", "__array__", "__bool__", "__getitem__", "__iter__", "__repr__"),
    torch.Tensor: ("numpy", "item", "tolist", "cpu", "__array__", "__bool__", "__float__", "__int__", "__index__"),
}


def count_reads(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Counts reads of arrays' values in the main thread from now on, by type and operation."""
    reads: Counter[str] = Counter()

    def counted(kind: type, name: str, original: Callable) -> Callable:
        def read(self: Any, *arguments: Any, **keywords: Any) -> Any:
            if threading.current_thread() is threading.main_thread() and _has_values(self):
                reads[f"{kind.__name__}.{name}"] += 1
            return original(self, *arguments, **keywords)

        return read

    for kind, names in _READS.items():
        for name in names:
            monkeypatch.setattr(kind, name, counted(kind, name, getattr(kind, name)))
    return reads


def _has_values(array: Any) -> bool:
    """Whether indexing gives a number, not a component of a vector or a slice of a tensor."""
    return not dr.is_array_v(array) or (dr.depth_v(array) == 1 and not dr.is_tensor_v(array))
