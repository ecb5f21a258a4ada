"""The scales of the terms of a loss, pooled over the batches of images that show how large their gradients are."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping

#: Lower bound of a scale, so that a gradient that is zero up to rounding is not amplified.
SMALLEST_SCALE = 1e-12


def rms_scales(sums: Iterable[Mapping[str, tuple[float, int]]]) -> dict[str, float]:
    """Pool results of `gradient_square_sum`, e.g. of all frames: RMS by name, at least `SMALLEST_SCALE`."""
    squares: defaultdict[str, float] = defaultdict(float)
    counts: Counter[str] = Counter()
    for batch in sums:
        for name, (square_sum, count) in batch.items():
            squares[name] += square_sum
            counts[name] += count
    return {name: max(math.sqrt(squares[name] / counts[name]), SMALLEST_SCALE) for name in counts}
