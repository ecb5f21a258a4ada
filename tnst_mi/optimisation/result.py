"""What an optimisation tells while it goes on, and what it gives in the end."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Progress:
    """Where a run stands, reported after every iteration of every frame; `done` of `total` of them."""

    frame: str
    octave: int
    octaves: int
    iteration: int
    iterations: int
    loss: float
    terms: dict[str, float]
    done: int
    total: int


@dataclass
class Stylized:
    """Result of stylizing one frame.

    Attributes:
        density: d*, blended as the recipe says, (D, H, W) float32, full resolution.
        velocity: v*, (D, H, W, 3) float32, full-resolution cells per frame; 0 for the density parameterisation.
        potential: (Φ, Ψ) at full resolution, None for an absent one.
        history: one dictionary per iteration: octave, iteration, loss, terms, seconds.
        interrupted: Ctrl-C ended the optimisation early; the result is what was reached.
        note: a remark for the user, such as for an empty frame.
        timings: seconds of each octave ("octave 0", ...) and in total.
        loss_before, loss_after: loss of the unstylized and the stylized density, the mean over the same three views;
            None where nothing was stylized.
        terms_before, terms_after: likewise the terms of the loss, unscaled and so comparable between runs.
    """

    density: np.ndarray
    velocity: np.ndarray
    potential: tuple[np.ndarray | None, np.ndarray | None] = (None, None)
    history: list[dict] = field(default_factory=list)
    interrupted: bool = False
    note: str | None = None
    timings: dict[str, float] = field(default_factory=dict)
    loss_before: float | None = None
    loss_after: float | None = None
    terms_before: dict[str, float] = field(default_factory=dict)
    terms_after: dict[str, float] = field(default_factory=dict)
