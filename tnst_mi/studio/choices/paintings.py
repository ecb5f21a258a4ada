"""What is painted on the page, kept as pictures that masks name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.io.atomic import make_folder, written_whole
from tnst_mi.studio.choices.masks import MaskEdit
from tnst_mi.studio.choices.uploads import as_png, read_upload

#: Edge of a painting in pixels, and paintings that are kept, at most.
_LARGEST, _MOST = 2048, 500


class Paintings:
    """A folder of paintings. None is written a second time, since masks of tries and renders name them.

    Args:
        folder: which need not exist.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder.absolute()

    def added(self, body: bytes, target: int, view: tuple[float, float], edit: Callable[[MaskEdit], None]) -> None:
        """Add what has been painted over a view of a frame to a mask.

        Args:
            body: the file of a picture with transparency, of the whole frame of the view; see `keep`.
            target: index of the target whose mask it is.
            view: (azimuth, elevation) in degrees.
            edit: edits masks.

        Raises:
            InputError: see `keep`, or raised by `edit`; then it is not kept.
        """
        file = self.keep(body)
        try:
            edit(MaskEdit("add", target, values={"image": str(file), "view": list(view)}))
        except InputError:
            file.unlink()
            raise

    def keep(self, body: bytes) -> Path:
        """Keep a painting as a white picture that is as opaque as it was, and return its file.

        Args:
            body: a file of a picture with transparency.

        Raises:
            InputError: it is none, too large, or wholly transparent, or there are too many.
        """
        picture = read_upload("the painting", body)
        rows, columns = picture.grey.shape
        if picture.alpha is None:
            raise InputError("the painting: has no transparency, expected what is painted on a transparent ground")
        if max(rows, columns) > _LARGEST:
            raise InputError(f"the painting: has {columns}×{rows} pixels, expected at most {_LARGEST} along each edge")
        make_folder(self._folder)
        numbers = [int(file.stem) for file in self._folder.glob("*.png") if file.stem.isdigit()]
        if len(numbers) >= _MOST:
            raise InputError(f"{self._folder}: has {_MOST} paintings already; remove some")
        file = self._folder / f"{max(numbers, default=0) + 1:04d}.png"
        # White, so that it counts as much where it is opaque everywhere, which means that its grey counts.
        with written_whole(file) as temporary:
            temporary.write_bytes(as_png(np.ones_like(picture.alpha), picture.alpha))
        return file
