"""How far the quadrature `exact` is from the closed form where a wall of the grid cuts smoke, for docs/physics.md.

python scripts/measure_cut_smoke.py
"""

from __future__ import annotations

import argparse

import numpy as np

import tnst_mi
from tnst_mi.compare.closed_form import closed_form, column_density
from tnst_mi.compare.values import our_images
from tnst_mi.resources import scene_file

VIEWS = ((0.0, 0.0), (35.0, 12.0), (-80.0, -25.0))

STEPS = (1.0, 1 / 4, 1 / 16, 1 / 64)

#: Row above which the frame is cut: in the middle of its smoke.
ROW = 40


def noise(*shape: int) -> np.ndarray:
    """Smoke that fills a grid, averaged over 3 cells along each axis."""
    values = np.random.default_rng(1).normal(size=shape)
    for axis in range(3):
        values = sum(np.roll(values, shift, axis) for shift in (-1, 0, 1)) / 3**0.5
    return (0.9 * np.abs(values) + 0.1).astype(np.float32)


def errors(density: np.ndarray, gamma: float) -> list[str]:
    """At each step the RMS and the largest difference over the RMS of a view, of the worst view."""
    closed = np.stack([closed_form(column_density(density, view), gamma) for view in VIEWS])
    size = np.sqrt((closed**2).mean((1, 2)))
    found = []
    for step in STEPS:
        apart = np.abs(our_images(density, VIEWS, gamma, "exact", step) - closed)
        rms = float((np.sqrt((apart**2).mean((1, 2))) / size).max())
        found.append(f"{rms:.2g}, {float((apart.max((1, 2)) / size).max()):.2g}")
    return found


def main() -> None:
    """Print the table."""
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    tnst_mi.activate()
    (frame,) = tnst_mi.load_frames(scene_file("suzanne/frame_0010.npz"))
    small = noise(6, 9, 7)
    rows = {
        "suzanne, γ 0.5, whole": (frame.density, 0.5),
        f"the same, cut at row {ROW}": (np.ascontiguousarray(frame.density[:, :ROW]), 0.5),
        "noise filling 32×48×32 cells, γ 0.1": (noise(32, 48, 32), 0.1),
        "noise filling 6×9×7 cells, γ 0.4": (small, 0.4),
        "the same with two empty cells around": (np.pad(small, 2), 0.4),
    }
    print(f"| | {' | '.join(f'step {step:g}' for step in STEPS)} |\n{'|---' * (1 + len(STEPS))}|")
    for name, (density, gamma) in rows.items():
        print(f"| {name} | {' | '.join(errors(density, gamma))} |")


if __name__ == "__main__":
    main()
