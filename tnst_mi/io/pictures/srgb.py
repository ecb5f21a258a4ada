"""The transfer curve of sRGB (IEC 61966-2-1): linear light, and the values that displays and pictures have for it."""

from __future__ import annotations

import numpy as np

#: Relative luminance of linear red, green and blue, whose primaries are those of ITU-R BT.709.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


def srgb(linear: np.ndarray) -> np.ndarray:
    """The display values of linear ones, float32 of any shape; 0 and 1 stay what they are.

    Example:
        >>> import numpy as np
        >>> from tnst_mi.io.pictures.srgb import srgb
        >>> srgb(np.array([0.0, 0.2, 1.0])).round(3).tolist()
        [0.0, 0.484, 1.0]
    """
    linear = np.asarray(linear)
    shown = np.empty(linear.shape, np.float32)
    for row, part in zip(np.atleast_2d(shown), np.atleast_2d(linear), strict=True):
        # In double precision, in which the value of 1 is 1.
        values = part.astype(np.float64)
        curved = 1.055 * np.maximum(values, 0.0031308) ** (1 / 2.4) - 0.055
        row[...] = np.where(values <= 0.0031308, 12.92 * values, curved)
    return shown


def linear_of(shown: np.ndarray) -> np.ndarray:
    """The linear values of display values, float32 of any shape: the inverse of `srgb`."""
    shown = np.asarray(shown)
    linear = np.empty(shown.shape, np.float32)
    for row, part in zip(np.atleast_2d(linear), np.atleast_2d(shown), strict=True):
        values = part.astype(np.float64)
        curved = ((np.maximum(values, 0.04045) + 0.055) / 1.055) ** 2.4
        row[...] = np.where(values <= 0.04045, values / 12.92, curved)
    return linear
