"""What an optimisation reports while it runs, and what it returns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tnst_mi.optimisation.movement import Movement
from tnst_mi.optimisation.start import State


@dataclass(frozen=True)
class Progress:
    """The progress of a run, reported after every iteration of every frame: `done` of `total` iterations.

    With several processes, there are so many `workers`; 0 without.
    """

    frame: str
    octave: int
    octaves: int
    iteration: int
    iterations: int
    loss: float
    terms: dict[str, float]
    done: int
    total: int
    workers: int = 0


@dataclass
class Stylized:
    """Result of stylizing one frame.

    Attributes:
        density: d*, blended as the recipe says, (D, H, W) float32, full resolution.
        velocity: v*, (D, H, W, 3) float32, full-resolution cells per frame; 0 for the density parameterisation.
        potential: (Φ, Ψ) at full resolution, None for an absent one.
        history: one dictionary per iteration: octave, iteration, loss, terms, seconds.
        interrupted: Ctrl-C ended the optimisation early; the result is the state at that point.
        note: a remark for the user, for example on an empty frame.
        timings: seconds of each octave ("octave 0", ...) and in total.
        loss_before, loss_after: loss of the unstylized and the stylized density, the mean over the same three views;
            None if nothing was stylized.
        terms_before, terms_after: likewise the terms of the loss, unscaled and so comparable between runs.
        state: from which another run can go on; None for a frame that is left unchanged.
        movement: what moves the frame's other grids likewise; None where nothing moves.
        colour: that of the stylized smoke, (D, H, W, 3) float32 display values in [0, 1]; None if it was not optimised.
        colour_grid: the name of the grid in which it is written.
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
    state: State | None = None
    movement: Movement | None = None
    colour: np.ndarray | None = None
    colour_grid: str | None = None
