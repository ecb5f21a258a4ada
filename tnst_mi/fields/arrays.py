"""Lets public functions take numpy, Dr.Jit or torch arrays and return an array of the same kind."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any, TypeGuard

import drjit as dr
import mitsuba as mi
import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.fields.torch_operation import called_from_torch
from tnst_mi.machine.backend import VARIANTS, own_variant, torch_device
from tnst_mi.machine.lazy import LazyModule

if TYPE_CHECKING:
    import torch
else:
    torch = LazyModule("torch")


#: Whole numbers that count as parts of their largest where an array has values from 0 to 1, by type, as in pictures.
LARGEST = {"uint8": 255, "uint16": 65535}


def _is_torch(value: Any) -> TypeGuard[torch.Tensor]:
    """Whether a value is a torch tensor, without importing torch."""
    return type(value).__module__.partition(".")[0] == "torch"


def any_array_kind(
    *names: str, differentiable: bool = True, from_0_to_1: Collection[str] = ()
) -> Callable[[Callable], Callable]:
    """Decorator for a function of `mi.TensorXf` arguments called `names` that returns one `mi.TensorXf`.

    Dr.Jit tensors pass through, with their derivatives. Torch's autograd differentiates the function of torch tensors.
    Numpy arrays (and anything numpy converts) give a numpy array back. A function that is not differentiable takes no
    tensors with derivatives, rather than dropping these in silence. Of arrays called `from_0_to_1`, whole numbers count
    as parts of their largest, see `LARGEST`; those of other types are refused with InputError.

    Threads take turns. Another package's variant is put back after the call, so that derivatives need one of ours.
    """

    def decorate(function: Callable) -> Callable:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def wrapper(*args: Any, **kwargs: Any) -> Any:
            bound = signature.bind(*args, **kwargs)
            bound.apply_defaults()
            given = {name: bound.arguments[name] for name in names if bound.arguments[name] is not None}
            for name in given.keys() & set(from_0_to_1):
                given[name] = _as_parts(given[name], f"{function.__name__}: {name}")
            if any(_carries_derivatives(value) for value in given.values()):
                if not differentiable:
                    raise TypeError(f"{function.__name__} is not differentiable: detach its arguments")
                _require_lasting_variant(function.__name__)
            with own_variant():
                return call(bound.arguments, given)

        def call(arguments: dict[str, Any], given: dict[str, Any]) -> Any:
            if any(_is_torch(value) for value in given.values()):
                return _call_from_torch(function, arguments, given)
            if any(dr.is_array_v(value) for value in given.values()):
                return function(**(arguments | {name: _as_tensor(value) for name, value in given.items()}))
            tensors = {name: mi.TensorXf(np.ascontiguousarray(value, np.float32)) for name, value in given.items()}
            return function(**(arguments | tensors)).numpy()

        return wrapper

    return decorate


def _as_parts(value: Any, what: str) -> Any:
    """An array whose whole numbers, if it has some, are parts of the largest of their type.

    Raises:
        InputError: they are of another type than those of `LARGEST`.
    """
    if dr.is_array_v(value):
        kind = "float32" if dr.is_float_v(value) else dr.type_v(value).name.lower()
    elif _is_torch(value):
        kind = str(value.dtype).rpartition(".")[2]
    else:
        value = np.asarray(value)
        kind = value.dtype.name
    if "float" in kind:
        return value
    if kind not in LARGEST:
        raise InputError(
            f"{what} of {kind} given, expected floating-point numbers, or uint8 or uint16 of which the largest counts "
            "as 1"
        )
    values = value.astype(np.float32) if isinstance(value, np.ndarray) else value.float()
    return values / LARGEST[kind]


def _carries_derivatives(value: Any) -> bool:
    if _is_torch(value):
        return value.requires_grad and torch.is_grad_enabled()
    return dr.is_array_v(value) and dr.grad_enabled(value)


def _require_lasting_variant(function: str) -> None:
    """Raise InputError if the variant is another package's, to which it is set back before derivatives are taken."""
    active = mi.variant()
    if active is not None and active not in VARIANTS:
        raise InputError(
            f"{function}: the variant {active} is active, and derivatives need one of {', '.join(VARIANTS)} until they "
            "have been taken: call tnst_mi.activate() before"
        )


def _as_tensor(value: Any) -> mi.TensorXf:
    return value if isinstance(value, mi.TensorXf) else mi.TensorXf(value)


def _call_from_torch(function: Callable, arguments: dict[str, Any], given: dict[str, Any]) -> Any:
    others = {name: value for name, value in arguments.items() if name not in given}
    tensors = {name: torch.as_tensor(value) for name, value in given.items()}
    home = next(value.device for value in given.values() if _is_torch(value))

    def call(*values: mi.TensorXf) -> mi.TensorXf:
        return function(**dict(zip(tensors, values, strict=True)), **others)

    # Dr.Jit cannot mix another device with the variant's.
    device = torch_device()
    return called_from_torch(call, [tensor.to(device).float().contiguous() for tensor in tensors.values()]).to(home)
