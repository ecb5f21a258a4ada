"""Counts what is read from the device, and forbids Dr.Jit to wait for it."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import drjit as dr
import mitsuba as mi
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

#: Operations that read values of Dr.Jit's arrays. Those that read many of them are refused too while Dr.Jit must not
#: wait, and so is `dr.compress`, which reads a count.
_DRJIT = ("numpy", "item", "memview", "__array__", "__bool__", "__getitem__", "__iter__", "__repr__")

_KINDS = ("Float", "Float16", "Int32", "UInt32", "Int64", "Bool", "TensorXf", "TensorXf16", "Vector3f")

_TORCH = ("numpy", "tolist", "cpu", "__array__")

#: What torch itself does to read a number, a truth value or the places that are not 0.
_ATEN = ("aten::_local_scalar_dense", "aten::equal", "aten::nonzero")


def _selects_by_mask(name: str, arguments: tuple) -> bool:
    """Whether an operation must know how many values a mask selects."""
    return name.startswith("aten::index") and any(
        isinstance(index, torch.Tensor) and index.dtype == torch.bool
        for argument in arguments
        if isinstance(argument, list | tuple)
        for index in argument
    )


class _Dispatched(TorchDispatchMode):
    """Counts torch's own reads."""

    def __init__(self, reads: Counter[str]) -> None:
        super().__init__()
        self._reads = reads

    def __torch_dispatch__(self, function: Any, types: Any, arguments: Any = (), keywords: Any = None) -> Any:
        name = function.name().partition(".")[0]
        if name in _ATEN or _selects_by_mask(name, arguments):
            self._reads[name] += 1
        return function(*arguments, **(keywords or {}))


@contextmanager
def counted_reads(monkeypatch: pytest.MonkeyPatch) -> Iterator[Counter[str]]:
    """Counts reads of values in the main thread, by type and operation; in these, Dr.Jit must not wait for results.

    On LLVM, torch is given an array once it has been computed. This waiting is allowed, and counted by shape as
    "exchange".
    """
    reads: Counter[str] = Counter()

    def counted(kind: str, name: str, original: Callable) -> Callable:
        def read(self: Any, *arguments: Any, **keywords: Any) -> Any:
            if threading.current_thread() is threading.main_thread() and not _is_component(self, name):
                reads[f"{kind}.{name}"] += 1
            return original(self, *arguments, **keywords)

        return read

    def exchanged(original: Callable) -> Callable:
        def give(self: Any, *arguments: Any, **keywords: Any) -> Any:
            reads[f"exchange {'x'.join(str(n) for n in self.shape)}"] += 1
            with dr.scoped_set_flag(dr.JitFlag.ForbidSynchronization, False):
                return original(self, *arguments, **keywords)

        return give

    def moved(original: Callable) -> Callable:
        def to(self: Any, *arguments: Any, **keywords: Any) -> Any:
            if any(str(argument).startswith("cpu") for argument in (*arguments, *keywords.values())):
                reads["Tensor.to"] += 1
            return original(self, *arguments, **keywords)

        return to

    with monkeypatch.context() as patch:
        # The types themselves: their own methods come before those of their common base.
        for kind in (getattr(mi, name) for name in _KINDS):
            for name in _DRJIT:
                patch.setattr(kind, name, counted(kind.__name__, name, getattr(kind, name)))
            for name in ("torch", "__dlpack__"):
                patch.setattr(kind, name, exchanged(getattr(kind, name)))
        for name in _TORCH:
            patch.setattr(torch.Tensor, name, counted("Tensor", name, getattr(torch.Tensor, name)))
        patch.setattr(torch.Tensor, "to", moved(torch.Tensor.to))
        with _Dispatched(reads), dr.scoped_set_flag(dr.JitFlag.ForbidSynchronization, True):
            yield reads


def _is_component(array: Any, name: str) -> bool:
    """Whether this only takes a vector apart, or slices a tensor."""
    return name in ("__getitem__", "__iter__") and dr.is_array_v(array) and dr.depth_v(array) > 1
