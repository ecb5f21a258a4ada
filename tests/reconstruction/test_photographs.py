"""Pictures and masks as numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tnst_mi.reconstruction.photographs import read_weights

#: What counts: all but the left half.
COUNTS = np.repeat([[0, 0, 255, 255]], 3, axis=0).astype(np.uint8)


@pytest.mark.parametrize("kind", ["grey", "painted", "painted with an opaque alpha", "cut out", "cut out of black"])
def test_masks_of_all_kinds(kind: str, tmp_path: Path) -> None:
    colours, full = np.stack([COUNTS] * 3, axis=-1), np.full_like(COUNTS, 255)
    pixels = {
        "grey": COUNTS,
        "painted": colours,
        "painted with an opaque alpha": np.dstack([colours, full]),
        "cut out": np.dstack([np.full_like(colours, 128), COUNTS]),
        "cut out of black": np.dstack([np.zeros_like(colours), COUNTS]),
    }[kind]
    Image.fromarray(pixels).save(tmp_path / "mask.png")
    assert (read_weights(tmp_path / "mask.png", COUNTS.shape) == COUNTS / 255).all()
