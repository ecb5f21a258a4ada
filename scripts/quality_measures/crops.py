"""Square pieces of pictures, at places inside the smoke that are drawn with fixed seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tnst_mi.errors import InputError

#: Edge of a piece in pixels: what the package calls the size of a motif, or half of a smaller picture's shorter side.
EDGE = 24

#: Pieces that are drawn from each picture.
COUNT = 32


@dataclass(frozen=True, eq=False)
class Picture:
    """A grey picture, and where it counts.

    Attributes:
        grey: (H, W) float32, in about [0, 1].
        inside: (H, W) bool, True where the smoke is, or the style is opaque.
    """

    grey: np.ndarray
    inside: np.ndarray


def edge_for(rows: int, columns: int) -> int:
    """The edge of the pieces of a picture, in pixels."""
    return max(1, min(EDGE, min(rows, columns) // 2))


def places(inside: np.ndarray, edge: int, count: int, seed: Sequence[int]) -> np.ndarray:
    """Upper left corners (count, 2), row and column, of pieces that are at least half as much inside as any can be.

    They are drawn with replacement, with probabilities in proportion to how much of a piece is inside.

    Args:
        inside: (H, W) bool.
        edge: of a piece in pixels, at most H and W.
        count: number of pieces.
        seed: of the draw.

    Raises:
        InputError: nothing is inside.
    """
    covered = np.lib.stride_tricks.sliding_window_view(inside, (edge, edge)).sum((2, 3), dtype=np.float64)
    if not covered.any():
        raise InputError("the picture shows no smoke to take pieces from; compare frames that are not empty")
    weights = np.where(covered >= 0.5 * covered.max(), covered, 0.0).ravel()
    drawn = np.random.default_rng(list(seed)).choice(weights.size, count, p=weights / weights.sum())
    return np.stack(np.unravel_index(drawn, covered.shape), axis=-1)


def pieces(plane: np.ndarray, corners: np.ndarray, edge: int) -> np.ndarray:
    """The pieces (N, edge, edge) of a plane (H, W) at these corners (N, 2)."""
    windows = np.lib.stride_tricks.sliding_window_view(plane, (edge, edge))
    return np.ascontiguousarray(windows[corners[:, 0], corners[:, 1]])


def drawn(pictures: Sequence[Picture], seed: int = 0, count: int = COUNT) -> tuple[np.ndarray, np.ndarray]:
    """Pieces of some pictures of one size, each with its own seed (seed, index): grey and inside, (N, edge, edge)."""
    edge = edge_for(*pictures[0].grey.shape)
    grey, inside = [], []
    for index, picture in enumerate(pictures):
        corners = places(picture.inside, edge, count, (seed, index))
        grey.append(pieces(picture.grey, corners, edge))
        inside.append(pieces(picture.inside, corners, edge))
    return np.concatenate(grey), np.concatenate(inside)
