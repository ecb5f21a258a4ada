"""An evaluation on a GPU, recorded once as a CUDA graph and replayed: a single launch in place of hundreds.

A GoogLeNet's value and derivative are about 500 kernels. Launching them takes the host about 9 ms (docs/gpu.md), more
than a GPU needs to compute them for the small images of the coarse octaves.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

#: From images and the factor of each term: the values of the terms (T,), and the derivative of their weighted sum.
Evaluation = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]


class RecordedEvaluation:
    """A recording for images of one shape. Replaying it gives the bits of the evaluation itself.

    Everything that decides which kernels run, such as the precision of products, is fixed when it is recorded, and so
    is where the network's weights are. The recording keeps the memory of the evaluation for as long as it lives.

    Args:
        evaluate: what to record. It must not read anything back to the host.
        images: (N, H, W) on a GPU.
        terms: number of terms.
        pool: the memory of another recording, to be used by this one too; both must not be replayed at the same time.

    Attributes:
        pool: the memory of this recording.
    """

    def __init__(self, evaluate: Evaluation, images: Tensor, terms: int, pool: Any = None) -> None:
        self._images, self._factors = torch.zeros_like(images), images.new_ones(terms)
        self._known = [1.0] * terms
        stream = _recording_stream(images.device)
        stream.wait_stream(torch.cuda.current_stream())
        # Libraries choose algorithms and allocate workspaces in the first evaluation, which cannot be recorded.
        with torch.cuda.stream(stream):
            evaluate(self._images, self._factors)
        torch.cuda.current_stream().wait_stream(stream)
        self._graph = torch.cuda.CUDAGraph()
        # Other threads may be waiting for copies meanwhile.
        with torch.cuda.graph(self._graph, pool=pool, stream=stream, capture_error_mode="thread_local"):
            self._values, self._derivative = evaluate(self._images, self._factors)
        self.pool: Any = self._graph.pool()

    def __call__(self, images: Tensor, factors: Sequence[float]) -> tuple[Tensor, Tensor]:
        """The values of the terms (T,), and the derivative (N, H, W) of their sum weighted by the factors."""
        self._images.copy_(images)
        for i, factor in enumerate(factors):
            # A number in a launch, where a tensor would have to be sent to the GPU.
            if factor != self._known[i]:
                self._factors[i].fill_(factor)
                self._known[i] = factor
        self._graph.replay()
        return self._values.clone(), self._derivative.clone()


@functools.cache
def _recording_stream(device: torch.device) -> torch.cuda.Stream:
    """A single one, since libraries allocate a workspace for every stream and keep it."""
    return torch.cuda.Stream(device)
