"""Values that no smoke has: one wild pixel would decide what counts as bright, and the smoke beside it as nothing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tnst_mi.errors import InputError
from tnst_mi.reconstruction.photographs import Photograph
from tnst_mi.reconstruction.settings import ReconstructionSettings

#: Brightest pixels of a picture that may be wild: this many, or this share of it. Smoke shows in more.
_FEW, _SHARE = 4, 1e-4

#: How many times as bright as all others wild pixels are.
_WILD = 100.0

#: How many times as bright as the thickest smoke, or what is behind it, pixels may be: noise, and a γ that is off.
_BEYOND = 10.0


def require_plausible(
    files: Sequence[Path], photographs: Sequence[Photograph], settings: ReconstructionSettings
) -> None:
    """Check that no pixel is far brighter than all others, nor than the thickest smoke could be, if that is known.

    Args:
        files: of the photographs, in their order.
        photographs: of a frame, in the unit of their files; masked pixels do not count.
        settings: what is known of their light.

    Raises:
        InputError: one is, by its magnitude.
    """
    brightest = [_brightest(photograph) for photograph in photographs]
    allowed = sum(_few(photograph) for photograph in photographs)
    others = np.sort(np.concatenate([found for found, _, _ in brightest]))[::-1][allowed:]
    usual = float(others[0]) if len(others) else 0.0
    possible = _possible(photographs, settings)
    limits = (
        (_WILD * usual or np.inf, f"nearly all other pixels are at most {usual:.3g}; mask it, or mend the picture"),
        (
            _BEYOND * possible,
            f"where no light gets through smoke it would be {possible:.3g}; say how bright smoke is by --brightness "
            "(or --gamma, for 1/gamma), or mask the pixel",
        ),
    )
    for limit, told in limits:
        for file, (_, (row, column), value) in zip(files, brightest, strict=True):
            if abs(value) > limit:
                raise InputError(f"{file}: the pixel in row {row}, column {column} is {value:.3g}, and {told}")


def _possible(photographs: Sequence[Photograph], settings: ReconstructionSettings) -> float:
    """The largest value that a pixel can have by the model of its light; infinite if something of that is unknown."""
    if settings.integrator == "prbvolpath" or settings.known_brightness is None or settings.background == "auto":
        return np.inf
    behind = [float(one.background.max()) for one in photographs if one.background is not None]
    return max(settings.known_brightness, float(settings.background), *behind, 0.0)


def _few(photograph: Photograph) -> int:
    return max(_FEW, round(_SHARE * photograph.values.size))


def _brightest(photograph: Photograph) -> tuple[np.ndarray, tuple[int, int], float]:
    """The magnitudes of the brightest pixels, one more than may be wild; and the first of them, (row, column), value.

    Rows and columns are counted from 0, from the top left corner.
    """
    magnitudes = np.where(photograph.weights > 0, np.abs(photograph.values), 0).ravel()
    place = int(magnitudes.argmax())
    row, column = divmod(place, photograph.values.shape[1])
    some = min(len(magnitudes), _few(photograph) + 1)
    return np.partition(magnitudes, -some)[-some:], (row, column), float(photograph.values[row, column])
