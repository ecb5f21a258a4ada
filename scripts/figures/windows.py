"""Temporal coherence: do wider windows flicker less? (paper, figure of window sizes)"""

from __future__ import annotations

import numpy as np
from compare_windows import rows_of

from figures.figure import Claim, Figure, Made, Panel
from figures.seen import images_of, smoke_box
from figures.setting import Setting
from tnst_mi import advect

_FRAMES = {"small": (57, 65), "paper": (57, 81)}
_KEYS = {
    "small": {"style": ["spirals"], "octaves": 2, "iterations": 10, "views": 2, "eta": 0.004},
    "paper": {"style": ["spirals"], "octaves": 2, "iterations": 20, "views": 9},
}
_WINDOWS = (1, 5, 9)
_SHOWN = 4


def make(setting: Setting) -> Made:
    """Stylize a sequence with windows of 1, 5 and 9 frames, and measure how its changes move with the smoke."""
    frames = setting.smoke("smokejet", *_FRAMES[setting.size])
    runs = {
        window: setting.stylized(f"windows-{window}", frames, window=window, **_KEYS[setting.size])
        for window in _WINDOWS
    }
    rows = {row["window"]: row for row in rows_of({window: run.record for window, run in runs.items()})}
    first = len(frames) // 2 - _SHOWN // 2
    shown = range(first, first + _SHOWN)
    before = [images_of(runs[1], frames[i].density)[0] for i in shown]
    box = smoke_box(before)
    strips = [[Panel(image[box], f"frame {frames[i].number}") for i, image in zip(shown, before, strict=True)]]
    for window, run in runs.items():
        row = [Panel(images_of(run, run.densities[i])[0][box], f"window {window}") for i in shown]
        changes = [run.densities[i] - frames[i].density for i in (first, first + 1)]
        carried = advect(changes[0], frames[first].velocity, "semi_lagrangian", outside="edge")
        new = np.abs(changes[1] - carried).max(0)[::-1]
        strips.append([*row, Panel(new[box], f"new: flicker {rows[window]['flicker']:.2f}")])
    flicker = {window: row["flicker"] for window, row in rows.items()}
    gained = {window: row["loss_change"] / row["loss_before"] for window, row in rows.items()}
    return Made(
        strips,
        [
            Claim(
                "Flicker falls with the window: "
                + ", ".join(f"{value:.3f} (window {window})" for window, value in flicker.items())
                + "; 0 is a change that moves with the smoke, √2 one that has nothing to do with it",
                flicker[1] > flicker[5] > flicker[9],
            ),
            Claim(
                "Stylization is left: the style loss falls by "
                + ", ".join(f"{share:.0%} (window {window})" for window, share in gained.items()),
                all(share > 0.4 * gained[1] for share in gained.values()),
            ),
        ],
        {"windows": list(rows.values())},
    )


FIGURE = Figure(
    "Windows of 1, 5 and 9 frames",
    "Averaging the gradients of a window of frames, carried along by the simulation's velocities, makes the "
    "stylization move with the smoke; the wider, the smoother, and 9 frames are used everywhere.",
    make,
    "Uniform windows, and nothing else that makes them steadier (docs/sequences.md). Steps are normalised, aligned and "
    "averaged over smoke, where the paper aligns gradients and normalises their average (docs/paper.md). On the right, "
    "what of a frame's change is not that of the frame before, carried along.",
)
