"""Staggered (marker-and-cell, MAC) velocities, averaged from the cell faces to the cell centres."""

from __future__ import annotations

import numpy as np


def centred_velocity(faces: np.ndarray, known: np.ndarray | None = None) -> np.ndarray:
    """Average a staggered velocity (component c on the lower face along its axis) to the cell centres.

    Both are (D, H, W, 3). The last cell's upper face is not stored: it takes the value of the lower one.

    Args:
        faces: velocities on the faces.
        known: (D, H, W) bool, the cells whose lower faces the file stores; None for all. A cell with one known face
            takes its value; a cell with none is 0.
    """
    centres = faces.astype(np.float32)
    for component, axis in enumerate((2, 1, 0)):
        values = np.moveaxis(centres[..., component], axis, 0)
        if known is None:
            values[:-1] = 0.5 * (values[:-1] + values[1:])
            continue
        weights = np.moveaxis(known, axis, 0).astype(np.float32)
        values *= weights
        values[:-1] += values[1:]
        weights[:-1] += weights[1:]
        values /= np.maximum(weights, 1.0)
    return centres


def velocity_of_all_faces(faces: np.ndarray) -> np.ndarray:
    """Average a staggered velocity with all faces, (D + 1, H + 1, W + 1, 3), to the cell centres, (D, H, W, 3).

    Of component c only the entries that are faces of a cell are used: its last ones along the other axes are not.
    """
    centres = np.empty((*(extent - 1 for extent in faces.shape[:3]), 3), np.float32)
    for component, axis in enumerate((2, 1, 0)):
        lower = np.moveaxis(faces[..., component], axis, 0)
        mean = 0.5 * (lower[:-1, :-1, :-1] + lower[1:, :-1, :-1])
        centres[..., component] = np.moveaxis(mean, 0, axis)
    return centres
