"""Copies from the device to the host that nobody waits for until they are read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tnst_mi.machine.lazy import LazyModule

if TYPE_CHECKING:
    import torch
else:
    torch = LazyModule("torch")


class HostCopy:
    """A copy of a tensor in host memory, started now.

    Reading an array of the device makes the host wait for everything that it has launched; a GPU then idles until the
    next launch. A copy into pinned memory is one more item in the queue instead, and an event tells when it is done.

    Torch and Dr.Jit need no further synchronisation: torch works on CUDA's legacy default stream, which waits for
    Dr.Jit's stream and is waited for by it.

    Args:
        tensor: a torch tensor; of a Dr.Jit tensor, its `.torch()`. In host memory it is not copied and must not change.
    """

    def __init__(self, tensor: torch.Tensor) -> None:
        self._copy, self._event = tensor.detach(), None
        if tensor.is_cuda:
            self._copy = torch.empty(tensor.shape, dtype=tensor.dtype, pin_memory=True)
            self._copy.copy_(tensor.detach(), non_blocking=True)
            self._event = torch.cuda.Event()
            self._event.record()

    @property
    def ready(self) -> bool:
        """Whether `numpy` need not wait."""
        return self._event is None or self._event.query()

    def numpy(self) -> np.ndarray:
        """The values, on a GPU in a copy of their own: pinned memory is not for keeping."""
        if self._event is None:
            return self._copy.numpy()
        self._event.synchronize()
        return self._copy.numpy().copy()
