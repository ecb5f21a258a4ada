"""Views of a small cloud, rendered once: fixtures of all tests of reconstructions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

GAMMA = 0.3


@pytest.fixture(scope="session")
def cloud() -> np.ndarray:
    """Two soft balls in 12 × 16 × 10 cells."""
    z, y, x = np.indices((12, 16, 10), np.float32)
    balls = [((5, 6, 4), 3.5, 1.0), ((7, 11, 6), 2.8, 0.6)]
    density = np.zeros((12, 16, 10), np.float32)
    for (a, b, c), radius, height in balls:
        far = np.sqrt((z - a) ** 2 + (y - b) ** 2 + (x - c) ** 2)
        density += height * np.clip(1.3 - far / radius, 0, 1)
    return density


@pytest.fixture(scope="session")
def renderer(cloud: np.ndarray) -> EmissionAbsorptionRenderer:
    """What renders it, in 20 × 20 pixels."""
    from tnst_mi.rendering.renderer import EmissionAbsorptionRenderer

    return EmissionAbsorptionRenderer(cloud.shape, GAMMA, "exact", 1.0, size=(20, 20))


@pytest.fixture(scope="session")
def views(cloud: np.ndarray, renderer: EmissionAbsorptionRenderer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """cameras.toml of 12 views and 3 that judge."""
    from render_views import write_views

    import tnst_mi

    out = tmp_path_factory.mktemp("views")
    return write_views(out, [tnst_mi.Frame(cloud)], renderer, (12, 3), 0.0, GAMMA)
