"""What descents have in common, whatever they find: they can be stopped after any step, and go on from there."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import torch
from torch import Tensor

from tnst_mi.fields.grid import Octave


class ResumableDescent(Protocol):
    """Steps of Adam on one grid.

    Attributes:
        adam: what changes it.
        steps, done: how many steps there are, and have been done.
    """

    adam: torch.optim.Adam
    steps: int
    done: int

    @property
    def octave(self) -> Octave:
        """The grid."""
        ...

    @property
    def unknown(self) -> Tensor:
        """What is to be found."""
        ...

    @property
    def remembered(self) -> Mapping[str, Tensor]:
        """What it knows besides, by names of its own."""
        ...

    def remember(self, tensors: Mapping[str, Tensor]) -> None:
        """Go on with what was `remembered`, among others.

        Raises:
            KeyError, TypeError, ValueError: it is not what was.
        """
        ...

    def step(self) -> float:
        """Do one more step; gives the mean square difference of its views, in units of the squared peak."""
        ...
