"""Functions of Dr.Jit tensors as operations of torch, computed and differentiated by one thread at a time.

`dr.wrap` does this for a single thread. With several, it mixes up what it keeps in a global variable, and a thread that
waits for a result of Dr.Jit on a CPU may go on before it is there while another waits too: with eight threads, some
gradients were wrong. So the derivative has to take its turn as a whole, with the copies before and after.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from tnst_mi.machine.lazy import LazyModule
from tnst_mi.machine.turns import turn

if TYPE_CHECKING:
    import torch
else:
    torch = LazyModule("torch")


def called_from_torch(function: Callable[..., mi.TensorXf], tensors: Sequence[torch.Tensor]) -> torch.Tensor:
    """The value of a function of Dr.Jit tensors at torch tensors, differentiable (in reverse mode, once) by torch.

    The caller has the turn.

    Args:
        function: takes as many Dr.Jit tensors as there are torch tensors.
        tensors: contiguous, in single precision, on the device of the active variant.
    """
    return _operation().apply(function, *tensors)


@functools.cache
def _operation() -> Any:
    """The operation; made when it is needed first, since importing torch takes a second."""

    class Operation(torch.autograd.Function):
        @staticmethod
        def forward(ctx: Any, function: Callable[..., mi.TensorXf], *tensors: torch.Tensor) -> torch.Tensor:
            ctx.inputs = [mi.TensorXf(tensor.detach()) for tensor in tensors]
            ctx.varied = [given for given, needed in zip(ctx.inputs, ctx.needs_input_grad[1:], strict=True) if needed]
            dr.enable_grad(ctx.varied)
            ctx.result = function(*ctx.inputs)
            return dr.detach(ctx.result).torch()

        @staticmethod
        @torch.autograd.function.once_differentiable
        def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
            with turn():
                dr.set_grad(ctx.result, mi.TensorXf(gradient.contiguous()))
                dr.backward_to(ctx.varied)
                return None, *(dr.grad(given).torch() if dr.grad_enabled(given) else None for given in ctx.inputs)

    return Operation
