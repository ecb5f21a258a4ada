"""The grids of a frame beside its density, such as temperature and flame: each is read when it is accessed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from tnst_mi.errors import InputError

#: Names that these grids cannot have: files of ours have other things under them.
ROLES = ("density", "velocity", "obstacle")


@dataclass(frozen=True, eq=False)
class OtherGrid:
    """A grid of a frame, with what its values do not say.

    Attributes:
        values: (D, H, W) or (D, H, W, 3), in the type of its file.
        outside: its value beyond the grid, () or (3,), such as the ambient temperature.
        stays: whether it keeps its place while the smoke moves, as the distances from a surface do.
    """

    values: np.ndarray
    outside: np.ndarray = field(default_factory=lambda: np.zeros(()))
    stays: bool = False


class OtherGrids(Mapping[str, np.ndarray]):
    """Grids by name. None of them is kept in memory: every access reads anew, from a file if they came from one.

    Args:
        readers: what reads each.
        cells: (D, H, W), the cells that all have.
        frame: the name of the frame, for messages.
    """

    def __init__(self, readers: Mapping[str, Callable[[], OtherGrid]], cells: tuple[int, ...], frame: str) -> None:
        self.readers, self.cells, self._frame = dict(readers), tuple(cells), frame

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, np.ndarray], cells: tuple[int, ...], frame: str) -> OtherGrids:
        """Grids that are arrays in memory, all of them checked.

        Raises:
            InputError: one has another shape, or holds something else than finite numbers, or cannot be called so.
        """
        for name in arrays:
            if not isinstance(name, str) or name in ROLES:
                raise InputError(f"{frame}: grids has {name!r}, expected other names than {', '.join(ROLES)}")
        values = {name: np.asarray(array) for name, array in arrays.items()}
        grids = cls({name: partial(OtherGrid, array) for name, array in values.items()}, cells, frame)
        for name in grids:
            grids.read(name)
        return grids

    def __len__(self) -> int:
        """Number of grids."""
        return len(self.readers)

    def __iter__(self) -> Iterator[str]:
        """Their names."""
        return iter(self.readers)

    def __contains__(self, name: object) -> bool:
        """Whether there is a grid of a name; nothing is read."""
        return name in self.readers

    def __getitem__(self, name: str) -> np.ndarray:
        """The values of a grid; see `read`."""
        return self.read(name).values

    def read(self, name: str) -> OtherGrid:
        """Read a grid.

        Raises:
            KeyError: there is none of this name.
            InputError: it cannot be used: it has another shape, or holds something else than finite numbers.
        """
        grid = self.readers[name]()
        values, cells = grid.values, self.cells
        if values.dtype.kind not in "fiub":
            raise InputError(f"{self._frame}: grid {name!r} has type {values.dtype}, expected numbers")
        if values.shape not in (cells, (*cells, 3)):
            raise InputError(
                f"{self._frame}: grid {name!r} has shape {values.shape}, expected {cells} or {(*cells, 3)} to fit the "
                "density"
            )
        bad = values.size - int(np.isfinite(values).sum())
        if bad:
            raise InputError(
                f"{self._frame}: grid {name!r} has {bad} NaN or infinite values, expected finite numbers; set them to "
                "0, or leave it out with --carry NAMES"
            )
        return grid
