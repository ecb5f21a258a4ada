"""Directions as colours: the hue says where to, the strength of the colour how far, the brightness how much smoke."""

from __future__ import annotations

import numpy as np

#: Towards the eye, and away from it.
_NEARER, _FARTHER = np.array([1.0, 0.55, 0.1]), np.array([0.15, 0.5, 1.0])


def coloured(right: np.ndarray, up: np.ndarray, brightness: np.ndarray, farthest: float) -> np.ndarray:
    """Pictures of vectors.

    Args:
        right, up: components (H, W) of the vectors in the picture.
        brightness: (H, W) in [0, 1].
        farthest: length of the vectors that have the full colour, ≥ 0.

    Returns:
        (H, W, 3) in [0, 1]: red to the right, yellow-green upwards, cyan to the left, violet downwards; grey where
        nothing moves.
    """
    share = np.clip(np.hypot(right, up) / farthest, 0.0, 1.0) if farthest > 0 else np.zeros_like(brightness)
    turn = np.arctan2(up, right) / (2 * np.pi)
    # Of the colours of the wheel, each of the three primaries is a third of a turn from the next.
    waves = [np.clip(np.abs((6 * (turn + third) + 3) % 6 - 3) - 1, 0.0, 1.0) for third in (0.5, 1 / 6, -1 / 6)]
    return brightness[..., None] * (1 - share[..., None] * (1 - np.stack(waves, axis=-1)))


def coloured_by_depth(towards: np.ndarray, brightness: np.ndarray, farthest: float) -> np.ndarray:
    """Pictures of the component of vectors towards the eye.

    Args:
        towards: that component (H, W), negative away from the eye.
        brightness: (H, W) in [0, 1].
        farthest: size of the components that have the full colour, ≥ 0.

    Returns:
        (H, W, 3) in [0, 1]: orange towards the eye, blue away from it; grey where nothing moves.
    """
    share = np.clip(np.abs(towards) / farthest, 0.0, 1.0) if farthest > 0 else np.zeros_like(brightness)
    colour = np.where(towards[..., None] > 0, _NEARER, _FARTHER)
    return brightness[..., None] * (1 - share[..., None] * (1 - colour))
