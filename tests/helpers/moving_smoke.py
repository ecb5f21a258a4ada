"""A short simulation in closed form: a lumpy cloud that a vortex carries around."""

from __future__ import annotations

import numpy as np
from fields import blob, smooth_noise

from tnst_mi.frame import Frame

SHAPE = (8, 12, 10)


def moving_smoke(count: int, shape: tuple[int, int, int] = SHAPE, first: int = 5) -> list[Frame]:
    """Frames numbered from `first`; velocities of about half a cell per frame."""
    rng = np.random.default_rng(4)
    lumps = 1 + np.abs(smooth_noise(rng, *shape))
    centre = np.array([shape[2], shape[1], shape[0]]) / 2 - 0.5
    z, y, x = np.indices(shape, dtype=np.float32)
    velocity = np.stack([-(y - centre[1]), x - centre[0], 0.2 * (z - centre[2])], axis=-1) * 0.15
    frames = []
    for i in range(count):
        angle = 0.15 * i
        place = centre + 2 * np.array([np.cos(angle), np.sin(angle), 0])
        density = np.clip(blob(shape, tuple(place), 2.2) * lumps, 0, 1)
        frames.append(Frame(density, velocity.astype(np.float32), name=f"s_{first + i:03d}", number=first + i))
    return frames
