"""Draw scenes/looks/sky.exr: the environment of the looks, brightest overhead, even at and below the horizon.

python scripts/draw_sky.py [--out sky.exr]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tnst_mi.io.pictures.exr import write_exr

SKY = Path(__file__).resolve().parents[1] / "scenes" / "looks" / "sky.exr"

#: Radiance at the horizon, and how many times brighter the zenith is.
HORIZON = (0.030, 0.036, 0.046)
ZENITH = 9.3

#: Elevations in degrees between which the sky brightens; the pictures show little more than the even part.
BRIGHTENS = (8.0, 70.0)


def sky(rows: int = 64) -> np.ndarray:
    """Radiance (rows, 8, 3) in longitude and latitude, zenith in row 0; the same all around."""
    elevation = 90.0 - (np.arange(rows) + 0.5) * 180.0 / rows
    low, high = BRIGHTENS
    t = np.clip((elevation - low) / (high - low), 0.0, 1.0)
    brightness = 1.0 + (ZENITH - 1.0) * t * t * (3.0 - 2.0 * t)
    return np.tile(brightness[:, None, None] * np.array(HORIZON), (1, 8, 1)).astype(np.float32)


def main() -> None:
    """Draw and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=SKY, help="the file (default: that of the looks)")
    out = parser.parse_args().out
    write_exr(out, sky(), {})
    print(out)


if __name__ == "__main__":
    main()
